"""Emulated XL430-W250 servos on a serial bus, exact to the byte."""
