"""Emulated XL430-W250 servos on a bus, true to the byte."""
