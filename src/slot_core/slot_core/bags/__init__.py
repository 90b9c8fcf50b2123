"""Recordings: writing, reading and decoding bags, and replaying them through the cores."""
