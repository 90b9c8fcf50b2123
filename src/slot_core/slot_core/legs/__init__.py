"""Statics of one leg: force map over tendon angle and height, leg with friction."""
