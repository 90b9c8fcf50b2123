"""Substitutes for the hardware: simulated robots with their sensors, servos and clocks."""
