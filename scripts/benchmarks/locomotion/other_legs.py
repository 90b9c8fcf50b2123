"""Other legs of a lab: `scripts/tune leg`, and the walk on them at the cruise speed that it found."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from unittest import mock

import yaml

from benchmarks.harness import Check, Row, at_least
from benchmarks.locomotion.cases import DEFAULT, Case, run_case
from benchmarks.locomotion.rows import WARM_UP
from slot_core import config
from slot_core.gait.gait import read_gaits
from slot_lab.tuning import tune_command

LEGS: dict[str, dict[str, Any]] = {
    "150 x 25 mm, tip 4 mm": {
        "reach": 0.15,
        "width": 0.025,
        "contact_width": 0.025,
        "thickness_tip": 0.004,
    },
    "220 mm, 15 to 5 mm": {
        "reach": 0.22,
        "thickness_clamp": 0.015,
        "thickness_tip": 0.005,
    },
    "azimuth 60 deg": {"azimuth_deg": [60.0, -60.0, 120.0, -120.0]},
}
"""Values of `leg` in robot.yaml."""
DURATION = 24.0  # s
ENOUGH = 0.9  # of the commanded speed


def row(name: str, out: Path) -> dict[str, Any]:
    """Commanded and reached speed, m/s, of the walk made for a leg, in a folder of `out`."""
    directory, robot = out / f"leg_{[*LEGS].index(name)}", config.load("robot")
    directory.mkdir(exist_ok=True)
    robot["leg"] |= LEGS[name]
    (directory / "robot.yaml").write_text(yaml.safe_dump(robot))
    with mock.patch.dict(os.environ):  # where the command names its directory
        tune_command.main(["leg", str(directory), "--gaits", "walk"])
        speed = read_gaits().strides["walk"].cruise
        walk = Case(DURATION, velocity=(speed, 0.0, 0.0))
        motion = run_case(walk, DEFAULT, 1).after(WARM_UP)
    reached = 0.0 if motion.fallen else motion.forward_speed
    return {"kind": "leg", "leg": name, "v_x": speed, "reached": reached}


def checks(found: Sequence[Row]) -> list[Check]:
    """The share of its cruise speed that each leg walks with."""
    return [
        at_least(
            f"leg {each['leg']}: of its cruise speed",
            each["reached"] / each["v_x"],
            ENOUGH,
        )
        for each in found
    ]
