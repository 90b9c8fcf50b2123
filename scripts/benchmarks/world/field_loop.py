"""Runs of the supervised loop whose readings pass through drivers, and how they end."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.locomotion.cases import STRIDES, WalkMotion, motion_of
from benchmarks.locomotion.rows import DEG, MM, WARM_UP
from benchmarks.world.drivers import CovariantOdometry, Driver
from benchmarks.world.sets import WorldSet
from slot_core import config
from slot_core.clock import LOCKSTEP_START, to_seconds
from slot_core.dynamics.scene import SolverSettings
from slot_core.gait.gait import STAND
from slot_core.refusal import DivergenceError
from slot_core.safety.states import State
from slot_core.safety.supervisor import Report
from slot_core.simulation.readings import Reading
from slot_core.simulation.supervised_loop import SupervisedLoop

DURATION = 14.0  # s
SETTLED = 1.0  # s, after which warnings and tilt count
ABNORMAL = (State.HOLD, State.RELAX, State.ESTOP, State.FAULT)
GAITS: Mapping[str, tuple[str, str]] = {
    "walk": ("flat", "walk"),
    "crawl": ("flat", "crawl"),
    "stand": ("flat", STAND),
    "slope5": ("slope5", "walk"),
}
"""Scene and gait by the name of their column."""


class FieldLoop(SupervisedLoop):
    """Supervised loop; readings pass through the drivers of their kind."""

    def __init__(
        self,
        scene: str,
        gait: str,
        seed: int,
        changes: Mapping[str, Any],
        drivers: Mapping[type, Driver],
    ) -> None:
        super().__init__(scene, gait, None, seed, changes=changes)
        self._drivers = drivers

    def receive(self, reading: Reading) -> None:
        """Give what the driver makes of a reading to the state estimator."""
        driver = self._drivers.get(type(reading), lambda r: [r])
        for given in driver(reading):
            if isinstance(given, CovariantOdometry):
                self.loop.controller.estimator.add_odometry(
                    given.stamp,
                    given.position,
                    given.quaternion,
                    given.velocity,
                    given.angular_velocity,
                    given.variance,
                )
            else:
                super().receive(given)


class Course:
    """States, lines and true motion of a run, report by report."""

    def __init__(self) -> None:
        self.states: list[State] = []
        self.lines: dict[str, str] = {}  # by their words, without numbers
        self._motion: list[list[float]] = []

    def add(self, report: Report, loop: FieldLoop) -> None:
        """Take a report and where the robot is."""
        time = to_seconds(loop.plant.now - LOCKSTEP_START)
        said = [w for w in report.warnings if "slewed" not in w]
        if not self.states or report.state is not self.states[-1]:
            self.states.append(report.state)
            said = [report.reason] * (report.state in ABNORMAL)
        elif time < SETTLED:
            said = []
        for line in said:
            self.lines.setdefault(re.sub(r"[-+.\d]+", "", line), line)
        robot = loop.plant.robot
        self._motion.append([time, *robot.position, *robot.rpy, 0.0, 0.0])

    def motion(self, gait: str) -> WalkMotion:
        """The true motion."""
        stride = STRIDES.get(gait, STRIDES["walk"])
        return motion_of(np.array(self._motion), False, stride.period)


def run_set(
    one: WorldSet, column: str, seed: int, *, duration: float, solver: str
) -> dict[str, Any]:
    """A run as a row: states, HOLDs, motion after the start, and the lines that it gave."""
    scene, gait = GAITS[column]
    level = config.read(SolverSettings, f"solver/{solver}")
    changes = {
        name: value for name, value, _ in config.leaves(level, "scene.solver.")
    }
    course, lines = Course(), []
    try:
        loop = FieldLoop(
            scene,
            gait,
            seed,
            changes | dict(one.changes),
            {kind: make() for kind, make in one.drivers.items()},
        )
        for report in loop.run(duration):
            course.add(report, loop)
    except (DivergenceError, RuntimeError) as error:
        course.states.append(State.FAULT)
        lines = [f"{type(error).__name__}: {error}"]
    lines += course.lines.values()
    return {
        "kind": "run",
        "set": one.name,
        "gait": column,
        "seed": seed,
        "states": short(course.states),
        "moved": State.WALKING in course.states
        or (gait == STAND and State.STANDING in course.states),
        "ended": course.states[-1].name,
        "holds": course.states.count(State.HOLD),
        "lines": lines,
        **measured(course.motion(gait), gait == STAND),
    }


def measured(whole: WalkMotion, stands: bool) -> dict[str, float]:
    """Motion: speed m/s, place aside mm, heading deg, largest tilt deg, height mm.

    Aside of the line that is walked, or of the place where it stands.
    """
    late, settled = whole.after(WARM_UP), whole.after(SETTLED)
    off = whole.position[:, not stands : 2] - whole.position[0, not stands : 2]
    aside = whole.moving_mean(np.hypot(*off.T) if stands else off[:, 0])
    return {
        "speed": float(late.velocity[0]),
        "aside": MM * float(np.abs(aside).max()),
        "heading": DEG * whole.heading,
        "tilt": DEG * float(settled.tilt.max()),
        "height": MM * float(late.position[:, 2].mean()),
    }


def short(states: Sequence[State]) -> str:
    """Initials of the states passed, R for READY and X for RELAX; repeats are counted."""
    letters = "".join("X" if s is State.RELAX else s.name[0] for s in states)
    return re.sub(
        r"((?:HW|HS){2,})", lambda m: f"({m[0][:2]}){len(m[0]) // 2}", letters
    )
