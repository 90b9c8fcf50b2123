"""Statics of one leg at the desk: force map over tendon angle and height, leg with friction."""
