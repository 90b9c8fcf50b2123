"""Another leg: its map, and the strides on it."""

import argparse
import os
import shutil
from functools import partial
from pathlib import Path

from slot_core import config
from slot_core.command_line import ProgressLine
from slot_core.gait.gait import read_gaits
from slot_core.legs.fingerprint import is_of
from slot_core.legs.leg_table import FILE, leg_map_made_for
from slot_core.robot import read_robot
from slot_lab.desk_command import Outcome
from slot_lab.leg_tests.leg_map import LegMapSettings, tabulate, write
from slot_lab.tuning.identification import IdentificationError
from slot_lab.tuning.tune import RECORDS, Tuning
from slot_lab.workers import mapper

MEND = "other --evaluations find other patterns"
SEARCH = {"friction": [0.4], "settling_strides": 3, "strides": 3}


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Make the map and the strides that the directory lacks; returns lines and exit code.

    options.parse: of the arguments of `scripts/tune`. A stride that cannot be made is a line and
    code 1. Raises ConfigError, ModuleNotFoundError, NoEquilibriumError, OSError.
    """
    directory = options.directory or config.config_dir()
    if not (directory / "robot.yaml").is_file():
        raise config.ConfigError(
            f"{directory}: no robot.yaml there; copy config/robot.yaml and set its leg"
        )
    _complete(directory)
    os.environ["SLOT_CONFIG"] = str(directory.absolute())  # workers inherit it
    robot, code = read_robot(), 0
    missing = [
        name
        for name in options.gaits
        if not is_of(config.load(f"gait/{name}").get("made_for"), robot)
    ]
    if not is_of(leg_map_made_for(), robot):
        grid = config.read(LegMapSettings, "leg_map")
        table = tabulate(robot, grid, partial(progress, "leg map"))
        write(directory / FILE, table, robot)
        progress.say(f"{directory / FILE}")
    with mapper(options.scheduler, options.workers) as run_all:
        for name in missing:
            gait = read_gaits().find(name)
            height = (gait.height, "--height-range", *gait.height_range)
            given = options.parse([name, "--height", *map(str, height)])
            given.command = (
                f"scripts/tune leg --evaluations {options.evaluations}"
            )
            tuning = Tuning(
                given,
                progress,
                (options.directory or Path()) / RECORDS,
                SEARCH | {"evaluations": options.evaluations},
            )
            try:
                lines = tuning.write(run_all)
            except IdentificationError as error:
                lines, code = [f"stays as it was: {error}; {MEND}"], 1
                tuning.forget()
            for line in lines:
                progress.say(f"{name}: {line}")
    return [f"SLOT_CONFIG={directory} scripts/run"], code


def _complete(directory: Path) -> None:
    """Copy what a directory lacks of the configuration; raises OSError."""
    ours = config.config_dir()

    def there(folder: str, names: list[str]) -> set[str]:
        copies = directory / Path(folder).relative_to(ours)
        return {name for name in names if (copies / name).is_file()}

    shutil.copytree(ours, directory, ignore=there, dirs_exist_ok=True)
