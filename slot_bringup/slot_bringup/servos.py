"""Servos on the bench, without a running graph: the tools of the configured brand."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from slot_core.command_line import prints_help, refuse
from slot_core.config import ConfigError
from slot_core.servos.registry import brand_of_help, read_brand


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `scripts/servos`; returns the exit code."""
    try:
        brand = brand_of_help() if prints_help() else read_brand()
        return brand.tools(arguments)
    except ConfigError as error:
        refuse("scripts/servos", error)
        return 1


if __name__ == "__main__":
    sys.exit(main())
