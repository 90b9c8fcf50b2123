"""Statics of one leg whose clamp is held horizontal: forces and stiffness over angle and height.

Without friction: the floor carries what the leg's shape and its tendon ask for, whatever the foot did
before. The branch is the one that starts at tendon angle zero and follows the angle upward.
"""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slot_core import config
from slot_core.dynamics import integrator
from slot_core.dynamics.compiled import kernel
from slot_core.dynamics.contact import touch
from slot_core.dynamics.integrator import Model, work_space
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.simulator import build_model, rest_state
from slot_core.robot import Array, Robot, read_robot

COLUMNS = (
    "theta_deg",
    "height_m",
    "force_N",
    "slope_N_per_rad",
    "stiffness_N_per_m",
    "contact_x_m",
)
HEIGHTS = np.linspace(0.015, 0.12, 22)  # m
ANGLES = 25  # from zero to the largest tendon angle
CHANGE = (math.radians(0.5), 5e-4)  # rad, m: half widths of the central differences
TOLERANCE = 1e-11  # m, last Newton correction of a node
ITERATIONS = 2000
# Reciprocal length of a pseudo time step, 1/s: small is Newton's method, large is careful.
CAREFUL, NEWTON = 20.0, 0.01


class NoEquilibrium(RuntimeError):
    """The iteration for an equilibrium did not converge; the message names the load."""


class Equilibrium(NamedTuple):
    """A leg at rest."""

    force: float  # N, vertical, of the floor on the leg
    contact_x: float  # m from the clamp, centre of pressure, or the tip where nothing touches
    tension: float  # N
    node: Array  # (N, 2) m from the clamp, x and z


class StaticLeg:
    """One leg on a frictionless floor, its clamp held horizontal; remembers its shape."""

    def __init__(self, robot: Robot, nodes: int, scene: str = "flat"):
        settings = config.replace(
            read_scene(scene), {"solver.nodes": nodes, "floor.friction": (0.0, 0.0, 0.0, 0.0)}
        )
        self.model: Model = build_model(robot, settings, read_servo())
        self._state = rest_state(self.model, 0.0)
        self._work = work_space(nodes)
        self._work.stage[0] = self.model.rod.node

    @property
    def node(self) -> Array:
        """(N, 2) present shape, m from the clamp; assign to choose where an iteration starts."""
        return self._work.stage[0].copy()

    @node.setter
    def node(self, node: Array) -> None:
        self._work.stage[0] = node

    def solve(self, angle: float, height: float) -> Equilibrium:
        """Equilibrium at a tendon angle (rad) and a clamp height (m), from the present shape.

        Raises NoEquilibrium.
        """
        self._state.tendon_angle[0] = angle
        for inv in (CAREFUL, NEWTON):
            change = relax(self.model, self._state, self._work, height, inv, TOLERANCE, ITERATIONS)
        if not change <= TOLERANCE:
            raise NoEquilibrium(
                f"leg at {math.degrees(angle):.3f} deg, {height:.4f} m: a node still moves"
                f" {change:.1e} m, limit {TOLERANCE:.0e} m"
            )
        out = np.zeros(2)
        pressure(self.model, self._work, height, out)
        force, x = float(out[0]), float(out[1])
        return Equilibrium(force, x, float(self._work.tension[0]), self.node)


@kernel
def relax(model, state, work, height, inv, tolerance, iterations):  # type: ignore[no-untyped-def]
    """Pseudo time steps of 1/inv from rest at the present shape; returns the last correction, m."""
    work.leg_motion[:] = 0.0
    work.leg_field[0, :] = (0.0, 0.0, 1.0)
    work.leg_field[1, :] = model.gravity
    stage, velocity = work.stage[0], work.velocity[0]
    state.tendon_rate[0] = 0.0
    change = 0.0
    for _ in range(iterations):
        work.velocity[0] = 0.0
        work.before[0] = 0.0
        integrator._load(model, state, work, 0, 0.0)
        integrator._eliminate(model, work, 0, inv, height)
        integrator._couple(model, work, 0, inv)
        work.vector[:] = 0.0
        integrator._substitute(model, work, 0, inv)
        change = 0.0
        for i in range(stage.shape[0]):
            dx, dz = velocity[i, 0] / inv, velocity[i, 2] / inv
            stage[i, 0] += dx
            stage[i, 1] += dz
            change = max(change, abs(dx), abs(dz))
        if change <= tolerance:
            break
    return change


@kernel
def pressure(model, work, height, out):  # type: ignore[no-untyped-def]
    """Write out (2,): vertical force of the floor, N, and its centre from the clamp, m."""
    force = moment = 0.0
    stage = work.stage[0]
    for i in range(1, stage.shape[0]):
        normal, _ = touch(model.floor, 0.0, height + stage[i, 1], 0.0, 0.0, 0.0, 0.0)
        force += normal
        moment += normal * stage[i, 0]
    out[0] = force
    out[1] = moment / force if force > 0.0 else stage[-1, 0]


def tabulate(robot: Robot, nodes: int) -> Array:
    """The map over `HEIGHTS` and the angles, (n, 6) in the order of `COLUMNS`, angle by angle."""
    angles = np.linspace(0.0, robot.tendon.angle_max, ANGLES)
    rows = [_column(robot, nodes, height, angles) for height in HEIGHTS]
    return np.stack(rows, axis=1).reshape(-1, len(COLUMNS))


def _column(robot: Robot, nodes: int, height: float, angles: Array) -> Array:
    """(n, 6) rows of the map at one height: lower the leg at angle zero, then pull."""
    leg = StaticLeg(robot, nodes)
    for h in np.linspace(max(HEIGHTS[-1], height), height, 50):
        leg.solve(0.0, h)
    rows, before = [], 0.0
    for angle in angles:
        for step in np.linspace(before, angle, 6)[1:]:
            leg.solve(step, height)
        before = angle
        rows.append(_row(leg, angle, height))
    return np.array(rows)


def _row(leg: StaticLeg, angle: float, height: float) -> tuple[float, ...]:
    here = leg.solve(angle, height)
    slopes = []
    for change in ((CHANGE[0], 0.0), (0.0, CHANGE[1])):
        forces = []
        for sign in (1.0, -1.0):
            leg.node = here.node
            forces.append(leg.solve(angle + sign * change[0], height + sign * change[1]).force)
        slopes.append((forces[0] - forces[1]) / (2 * sum(change)))
    leg.node = here.node
    return (math.degrees(angle), height, here.force, slopes[0], slopes[1], here.contact_x)


def write(path: Path, table: Array) -> None:
    """Write the map as CSV with a line of names."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([f"{value:.6g}" for value in row] for row in table)


def main(path: Path, nodes: int) -> None:
    """Tabulate the leg of `config/robot.yaml` into a file."""
    write(path, tabulate(read_robot(), nodes))
