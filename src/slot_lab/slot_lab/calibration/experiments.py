"""Predictions of the measurements: the single-leg tests of `data.py` on the simulated leg.

The scene is `flat`, with the friction of the measurement. The tests are
quasi-static: inertia is negligible and friction has its Coulomb value. The result depends on the
history of the motion, so the simulation follows it from rest. The tests load a leg in its plane
alone, which it does not leave.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import ConfigError, quantity
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY, LEGS, RobotParameters
from slot_core.simulation.rod_robot import RodRobot
from slot_lab.calibration.data import Datum
from slot_lab.calibration.fit import PredictionError
from slot_lab.csv_table import TableError
from slot_lab.leg_tests.held_leg import HeldLeg
from slot_lab.leg_tests.leg_map import StaticLeg
from slot_lab.leg_tests.level_leg import NoEquilibriumError

SAMPLE = 10e-3  # s, between two samples of the marker heights
FREE_HEIGHT = 10.0  # m, clamp height of a leg without floor
PULL_STEP = math.radians(5.0)  # of the tendon angle of a hanging leg, at most


@dataclass(frozen=True)
class ExperimentSettings:
    """Settings of the simulated tests: `config/calibration.yaml`."""

    nodes: int = quantity("nodes of the leg", "", 4, 401)
    pull_time: float = quantity(
        "of marker_range: T of theta sin(pi t / 2 T), t <= T", "s", 0.1, 100
    )
    hold_time: float = quantity(
        "of marker_range: time at the full angle", "s", 0, 100
    )
    pull_rate_deg: float = quantity(
        "of force_angle: rate of the tendon angle", "deg/s", 0.1, 1000
    )


def read_settings() -> ExperimentSettings:
    """The settings of `config/calibration.yaml`; raises ConfigError."""
    return config.read(ExperimentSettings, "calibration")


def predict(
    robot: RobotParameters, rows: Sequence[Datum], settings: ExperimentSettings
) -> Array:
    """(n,) predicted values of the measurements, in their units.

    Raises TableError for a tendon angle above the robot's largest, and PredictionError where the
    simulation of a test fails.
    """
    for row in rows:
        if row.theta_deg > robot.tendon.angle_max_deg:
            raise TableError(
                f"line {row.line}, theta_deg: {row.theta_deg:g} is above tendon.angle_max_deg"
                f" = {robot.tendon.angle_max_deg:g}"
            )
    out = np.full(len(rows), np.nan)
    tests: dict[
        tuple[Any, ...], list[int]
    ] = {}  # of rows of one kind with equal shared conditions
    for i, row in enumerate(rows):
        _, *shared = TESTS[row.kind]
        tests.setdefault(
            (row.kind, *(getattr(row, name) for name in shared)), []
        ).append(i)
    for (kind, *_), members in tests.items():
        try:
            out[members] = TESTS[kind][0](
                robot, [rows[i] for i in members], settings
            )
        except (DivergenceError, NoEquilibriumError, ConfigError) as error:
            raise PredictionError(
                f"{kind} of line {rows[members[0]].line}: {error}"
            ) from None
    return out


def marker_ranges(
    robot: RobotParameters, rows: Sequence[Datum], settings: ExperimentSettings
) -> Array:
    """(n,) ranges of the heights of points of a leg that lifts its load, m.

    The robot's four legs lift four times the load. By symmetry the torso neither tilts nor moves
    sideways, so that it is the guided clamp of each leg. The servo is ideal.
    """
    first = rows[0]
    changes = {
        "floor.friction": (first.friction,) * 4,
        "solver.nodes": settings.nodes,
        "start.tendon_angle_deg": 0.0,
    }
    loaded = config.replace(robot, {"torso.mass": 4 * first.load_N / GRAVITY})
    scene = config.replace(read_scene("flat"), changes)
    sim = RodRobot(
        loaded, scene, config.replace(read_servo(), {"model": "ideal"})
    )
    steps = max(1, round(SAMPLE / scene.solver.step))
    heights = [sim.nodes[0, :, 2]]
    while sim.time < settings.pull_time + settings.hold_time:
        part = math.sin(math.pi / 2 * min(1.0, sim.time / settings.pull_time))
        sim.advance(
            steps, np.full(len(LEGS), math.radians(part * first.theta_deg))
        )
        heights.append(sim.nodes[0, :, 2])
    share = sim.model.rod.arc / sim.model.rod.arc[-1]
    return np.array(
        [
            np.ptp([np.interp(row.place, share, height) for height in heights])
            for row in rows
        ]
    )


def forces(
    robot: RobotParameters, rows: Sequence[Datum], settings: ExperimentSettings
) -> Array:
    """(n,) vertical forces of the floor on a leg whose clamp is held, N."""
    first = rows[0]
    leg = HeldLeg(robot, settings.nodes, first.friction, first.height_m)
    rate, out = math.radians(settings.pull_rate_deg), np.zeros(len(rows))
    for i in np.argsort([row.theta_deg for row in rows], kind="stable"):
        out[i] = leg.pull(math.radians(rows[i].theta_deg), rate)
    return out


def deflections(
    robot: RobotParameters, rows: Sequence[Datum], settings: ExperimentSettings
) -> Array:
    """(n,) downward displacements of points of a hanging leg under weights at its tip, m."""
    leg = StaticLeg(robot, settings.nodes)
    angle, unloaded = math.radians(rows[0].theta_deg), leg.model
    share = unloaded.rod.arc / unloaded.rod.arc[-1]
    for part in np.linspace(0.0, angle, 1 + math.ceil(angle / PULL_STEP)):
        start = leg.solve(part, FREE_HEIGHT).node[:, 1]
    out = np.zeros(len(rows))
    for i in np.argsort([row.load_N for row in rows], kind="stable"):
        mass = unloaded.rod.mass.copy()
        mass[-1] += rows[i].load_N / GRAVITY
        leg.model = unloaded._replace(rod=unloaded.rod._replace(mass=mass))
        out[i] = np.interp(
            rows[i].place,
            share,
            start - leg.solve(angle, FREE_HEIGHT).node[:, 1],
        )
    return out


TESTS: dict[str, tuple[Any, ...]] = {
    "marker_range": (marker_ranges, "theta_deg", "load_N", "friction"),
    "force_angle": (forces, "height_m", "friction"),
    "deflection": (deflections, "theta_deg"),
}
"""By kind its simulation, then the conditions that its rows share."""
