"""Types of command line arguments, for argparse."""

from __future__ import annotations

import argparse


def positive_integer(text: str) -> int:
    """An integer of at least one; raises ArgumentTypeError, ValueError."""
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{value} is below 1")
    return value
