"""A hard case for the simulator of the whole robot: what is done, what must hold, what was seen.

Every case runs at its time step h and at h/2, and must stay finite. `Limits` bound the energy that
appears from nowhere, the depth to which anything sinks into the floor, and how far the two answers
are apart. What keeps a case within them is the step control of `integrator.py`; a `Record` counts
how often it had to act.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.simulated_robot import Divergence
from slot_core.robot import Array, read_robot
from slot_core.simulation.rod_robot import RodRobot

Changes = Mapping[str, Any]
STANDING_DEG = 63.0
TILT_ARM = 0.1  # m, at which a tilt counts as a displacement


@dataclass(frozen=True)
class Limits:
    """What must hold."""

    gained: float  # J, energy beyond that of the start and the servos' work
    sunk: float  # mm
    apart: float  # mm, between the answers at h and h/2, at any time


def stay(_: RodRobot) -> None:
    """Start as the scene does."""


def hold(degrees: float) -> Callable[[float], Array]:
    """Four equal tendon angles."""
    return lambda _: np.full(4, math.radians(degrees))


@dataclass(frozen=True)
class Case:
    """A robot and a scene (changes of `robot.yaml` and of the scene `flat`), and what is done."""

    limits: Limits
    scene: Changes
    robot: Changes = field(default_factory=dict)
    start: Callable[[RodRobot], None] = stay  # what is done to it first
    command: Callable[[float], Array] = hold(STANDING_DEG)  # (4,) rad at a time, s
    seconds: float = 0.6
    step: float = 1e-3  # s, h


@dataclass(frozen=True)
class Record:
    """What was seen at h; `apart` compares with h/2."""

    lost: str  # why the solution was lost, or nothing
    fastest: float  # m/s, of a node
    gained: float  # J
    sunk: float  # mm
    apart: float  # mm
    halvings: int
    indefinite: int
    unconverged: int

    def holds(self, limits: Limits) -> bool:
        """Whether all is finite and within the limits."""
        within = self.gained <= limits.gained and self.sunk <= limits.sunk
        return not self.lost and within and self.apart <= limits.apart


def examine(case: Case) -> Record:
    """Run a case at h and at h/2."""
    coarse, fine = Watch(case, case.step), Watch(case, case.step / 2)
    try:
        paths = [np.array(list(watch.run())) for watch in (coarse, fine)]
    except Divergence as error:
        return coarse.record(math.inf, str(error))
    return coarse.record(1e3 * float(np.abs(paths[0] - paths[1]).max()), "")


class Watch:
    """A run of a case at one time step, and the largest of all that is watched."""

    def __init__(self, case: Case, step: float) -> None:
        self._case, self._steps = case, round(case.step / step)
        scene = config.replace(read_scene("flat"), {**case.scene, "solver.step": step})
        self._sim = RodRobot(config.replace(read_robot(), case.robot), scene, read_servo())
        case.start(self._sim)
        self._budget = self._sim.energy()
        self._fastest, self._gained, self._sunk = 0.0, -math.inf, -math.inf

    def run(self) -> Iterator[Array]:
        """Yield the torso's place and tilt (5,), m, after every h."""
        for k in range(round(self._case.seconds / self._case.step)):
            command = self._case.command(k * self._case.step)
            for _ in range(self._steps):
                self._advance(command)
            yield np.append(self._sim.position, TILT_ARM * self._sim.rotation[2, :2])

    def record(self, apart: float, lost: str) -> Record:
        """What was seen."""
        sim = self._sim
        counts = sim.halvings, sim.indefinite_steps, sim.unconverged_steps
        return Record(lost, self._fastest, self._gained, 1e3 * self._sunk, apart, *counts)

    def _advance(self, command: Array) -> None:
        sim, before = self._sim, self._sim.tendon_angle
        sim.advance(1, command)
        reeled = sim.robot.tendon.spool_radius * (sim.tendon_angle - before)
        self._budget += float(sim.tension @ reeled)
        self._gained = max(self._gained, sim.energy() - self._budget)
        corners = sim.position + sim.model.torso.corners @ sim.rotation.T
        lowest = min(sim.nodes[:, 1:, 2].min(), corners[:, 2].min())
        self._sunk = max(self._sunk, -float(lowest))
        speed = np.linalg.norm(sim.state.node_velocity, axis=-1)
        self._fastest = max(self._fastest, float(speed.max()))
