"""Runs a hard case of the simulator of the whole robot and compares its record with its limits.

Every case runs at its time step h and at h/2, and must stay finite. `Limits` bound the energy over
the servos' work, the depth to which nodes and torso sink into the floor, and the difference between
the two solutions. The step control of `dynamics/integrator.py` keeps a case within them; a
`StressRecord` counts how often it acted.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.refusal import DivergenceError
from slot_core.robot import read_robot
from slot_core.simulation.rod_robot import RodRobot

Changes = Mapping[str, Any]
STANDING_DEG = 63.0
TILT_ARM = 0.1  # m, lever by which a tilt counts as a displacement
# Not that of servo.yaml: impacts do not repeat themselves, and the limits would change with it.
SERVO = ServoSettings(
    model="pid",
    lag=0.02,
    voltage=(11.1,),
    stall_torque=(1.4,),
    no_load_rpm=(57.0,),
    nominal_voltage=11.1,
    continuous_load=0.2,
    ideal_rpm=57.0,
    servo_per_tendon=1.0,
    proportional=14.253,
    integral=0.0,
    derivative=0.19,
    motor_time=0.01,
    backlash_deg=0.0,
)


@dataclass(frozen=True)
class Limits:
    """Limits of a case."""

    gained: float  # J, energy beyond the initial one and the servos' work
    sunk: float  # mm, depth in the floor
    apart: float  # mm, between the answers at h and h/2, at any time


def stay(_: RodRobot) -> None:
    """Start as in the scene."""


def hold(degrees: float) -> Callable[[float], Array]:
    """Command of four equal tendon angles at all times."""
    return lambda _: np.full(4, math.radians(degrees))


@dataclass(frozen=True)
class StressCase:
    """Changes of `robot.yaml` and of the scene `flat`, start, commands and limits of a case."""

    limits: Limits
    scene: Changes
    robot: Changes = field(default_factory=dict)
    start: Callable[[RodRobot], None] = stay  # changes the initial state
    command: Callable[[float], Array] = hold(STANDING_DEG)  # (4,) rad at a time, s
    seconds: float = 0.6
    step: float = 1e-3  # s, h


@dataclass(frozen=True)
class StressRecord:
    """Measurements at h; `apart` compares with h/2."""

    lost: str  # cause of the divergence; empty: none
    fastest: float  # m/s, of a node
    gained: float  # J
    sunk: float  # mm
    apart: float  # mm
    halvings: int
    indefinite: int
    unconverged: int

    def holds(self, limits: Limits) -> bool:
        """Whether the case stayed finite and within the limits."""
        within = self.gained <= limits.gained and self.sunk <= limits.sunk
        return not self.lost and within and self.apart <= limits.apart


def examine(case: StressCase) -> StressRecord:
    """Run a case at h and at h/2, and record it."""
    coarse, fine = MeasuredRun(case, case.step), MeasuredRun(case, case.step / 2)
    try:
        paths = [np.array(list(one.run())) for one in (coarse, fine)]
    except DivergenceError as error:
        return coarse.record(math.inf, str(error))
    return coarse.record(1e3 * float(np.abs(paths[0] - paths[1]).max()), "")


class MeasuredRun:
    """A run of a case at one time step, with the largest values of what the limits bound."""

    def __init__(self, case: StressCase, step: float) -> None:
        self._case, self._steps = case, round(case.step / step)
        # without the IMU, whose period is shorter than the longest time step
        changes = {**case.scene, "solver.step": step, "sensors.imu.enabled": False}
        scene = config.replace(read_scene("flat"), changes)
        self._sim = RodRobot(config.replace(read_robot(), case.robot), scene, SERVO)
        case.start(self._sim)
        self._budget = self._sim.energy()
        self._fastest, self._gained, self._sunk = 0.0, -math.inf, -math.inf

    def run(self) -> Iterator[Array]:
        """Yield the torso's position and tilt times TILT_ARM (5,), m, after every h."""
        for k in range(round(self._case.seconds / self._case.step)):
            command = self._case.command(k * self._case.step)
            for _ in range(self._steps):
                self._advance(command)
            yield np.append(self._sim.position, TILT_ARM * self._sim.rotation[2, :2])

    def record(self, apart: float, lost: str) -> StressRecord:
        """The record of the run."""
        sim = self._sim
        counts = sim.halvings, sim.indefinite_steps, sim.unconverged_steps
        return StressRecord(
            lost, self._fastest, self._gained, 1e3 * self._sunk, apart, *counts
        )

    def _advance(self, command: Array) -> None:
        sim, before = self._sim, self._sim.tendon_angle
        sim.advance(1, command)
        reeled = sim.parameters.tendon.spool_radius * (sim.tendon_angle - before)
        self._budget += float(sim.tension @ reeled)
        self._gained = max(self._gained, sim.energy() - self._budget)
        corners = sim.position + sim.model.torso.corners @ sim.rotation.T
        lowest = min(sim.nodes[:, 1:, 2].min(), corners[:, 2].min())
        self._sunk = max(self._sunk, -float(lowest))
        speed = np.linalg.norm(sim.state.node_velocity, axis=-1)
        self._fastest = max(self._fastest, float(speed.max()))
