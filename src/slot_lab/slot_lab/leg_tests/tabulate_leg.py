"""Writes the map of one leg at rest: force and stiffness over tendon angle and height.

config/leg_map.yaml has the grid and the number of nodes. The policies and the simulation of the
level `map` read the map.
"""

import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from slot_core import config
from slot_core.command_line import CommandParser, ProgressLine, refuse


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/calibrate --leg-map`: writes the map of config/leg_map.yaml."""
    parser = CommandParser(
        prog="scripts/calibrate --leg-map", description=__doc__
    )
    parser.add_argument(
        "--out",
        metavar="FILE",
        type=Path,
        default=config.config_dir() / "leg_map.csv",
        help="CSV file (default: %(default)s)",
    )
    out = parser.parse_args(arguments).out
    # known before the long computation
    if out.is_dir() or not out.parent.is_dir():
        parser.error(f"--out {out}: not a file in an existing directory")
    from slot_core.robot import read_robot  # noqa: PLC0415
    from slot_lab.leg_tests.leg_map import LegMapSettings, tabulate, write  # noqa: PLC0415 - heavy
    from slot_lab.leg_tests.level_leg import NoEquilibriumError  # noqa: PLC0415

    try:
        robot, grid = read_robot(), config.read(LegMapSettings, "leg_map")
        with ProgressLine(parser.prog) as progress:
            write(out, tabulate(robot, grid, partial(progress, "leg map")))
    except (config.ConfigError, NoEquilibriumError, OSError) as error:
        refuse(parser.prog, error)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
