"""Requests of an operator, and the keys of the terminal that make them."""

import re

REQUESTS = ("ready", "stand", "walk", "relax", "estop", "reset")
KEYS = {
    "r": "ready",
    "s": "stand",
    "w": "walk",
    "x": "relax",
    " ": "estop",
    "R": "reset",
}
QUIT = "q"
KEY = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]|.", re.S)  # one key's characters
