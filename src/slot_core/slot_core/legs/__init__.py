"""One leg at rest: its map of force over tendon angle and height, held legs, bending modes."""
