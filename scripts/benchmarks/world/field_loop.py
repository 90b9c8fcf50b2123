"""Runs of the supervised loop whose readings pass through drivers, and how they end."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.locomotion.cases import STRIDES, WalkMotion, motion_of
from benchmarks.locomotion.rows import DEG, MM, WARM_UP
from benchmarks.world.drivers import CovariantOdometry, Memory
from benchmarks.world.sets import WorldSet
from slot_core.clock import LOCKSTEP_START, to_seconds
from slot_core.dynamics.scene import level_changes
from slot_core.gait.gait import STAND
from slot_core.refusal import DivergenceError
from slot_core.safety.states import State
from slot_core.simulation.readings import (
    ImuReading,
    OdometryReading,
    Reading,
)
from slot_core.simulation.supervised_loop import SupervisedLoop

DURATION = 14.0  # s
SETTLED = 1.0  # s, after which warnings and tilt count
ABNORMAL = (State.HOLD, State.RELAX, State.ESTOP, State.FAULT)
GAITS: Mapping[str, tuple[str, str, float | None]] = {
    "walk": ("flat", "walk", None),
    "crawl": ("flat", "crawl", None),
    "stand": ("flat", STAND, None),
    "slope5": ("slope5", "walk", 0.04),
}
"""Scene, gait, and speed (m/s) if it is not that of the gait, by the name of their column."""


class FieldLoop(SupervisedLoop):
    """Supervised loop of a set; readings pass through its drivers."""

    def __init__(
        self, one: WorldSet, column: str, seed: int, changes: Mapping[str, Any]
    ) -> None:
        scene, gait, speed = GAITS[column]
        velocity = None if speed is None else np.array([speed, 0.0, 0.0])
        changes = {**changes, **one.changes}
        super().__init__(scene, gait, velocity, seed, changes=changes)
        self._drivers = {OdometryReading: one.odometry, ImuReading: one.imu}
        self._memory: dict[type, Memory] = {kind: {} for kind in self._drivers}

    def receive(self, reading: Reading) -> None:
        """Give what the driver makes of a reading to the state estimator."""
        kind = type(reading)
        if (driver := self._drivers.get(kind)) is None:
            super().receive(reading)
            return
        for given in driver(reading, self._memory[kind]):
            if isinstance(given, CovariantOdometry):
                values = vars(given).values()  # in the order of the message
                self.loop.controller.estimator.add_odometry(*values)
            else:
                super().receive(given)


def run_set(
    one: WorldSet, column: str, seed: int, *, duration: float, solver: str
) -> dict[str, Any]:
    """A run as a row: states, HOLDs, motion after the start, and the lines that it gave.

    lines: reasons of HOLD, RELAX and FAULT, and warnings after the start, each with the numbers
    that it had first.
    """
    level = {f"scene.{name}": x for name, x in level_changes(solver).items()}
    loop = FieldLoop(one, column, seed, level)
    states: list[State] = []
    motion, lines, robot = [], dict[str, str](), loop.plant.robot
    try:
        for report in loop.run(duration):
            time = to_seconds(loop.plant.now - LOCKSTEP_START)
            motion.append([time, *robot.position, *robot.rpy, 0.0, 0.0])
            said = report.warnings if time > SETTLED else ()
            if report.state not in states[-1:]:
                states.append(report.state)
                said = (report.reason,) * (report.state in ABNORMAL)
            for line in said:
                if "slewed" not in line:
                    lines.setdefault(re.sub(r"[-+.\d]+", "", line), line)
    except (DivergenceError, RuntimeError) as error:
        states.append(State.FAULT)
        lines["error"] = f"{type(error).__name__}: {error}"
    gait = GAITS[column][1]
    moving = State.STANDING if gait == STAND else State.WALKING
    whole = motion_of(
        np.array(motion), False, STRIDES.get(gait, STRIDES["walk"]).period
    )
    return {
        "set": one.name,
        "gait": column,
        "seed": seed,
        "states": [state.name for state in states],
        "moved": moving in states,
        "ended": states[-1].name,
        "holds": states.count(State.HOLD),
        "lines": [*lines.values()],
        **measured(whole, gait == STAND),
    }


def measured(whole: WalkMotion, stands: bool) -> dict[str, float]:
    """Motion: speed m/s, place aside mm, heading deg, largest tilt deg, height mm.

    Aside of the line that is walked, or of the place where it stands, in means over a stride.
    """
    late, settled = whole.after(WARM_UP), whole.after(SETTLED)
    x, y = (settled.moving_mean(column) for column in settled.position.T[:2])
    aside = np.hypot((x - x[0]) * stands, y - y[0])
    return {
        "speed": float(late.velocity[0]),
        "aside": MM * float(aside.max()),
        "heading": DEG * whole.heading,
        "tilt": DEG * float(settled.tilt.max()),
        "height": MM * float(late.position[:, 2].mean()),
    }
