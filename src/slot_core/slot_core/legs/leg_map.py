"""Statics of one leg with a horizontal clamp: force and stiffness over tendon angle and height.

The floor has no friction, so that the force depends on angle and height alone and not on the motion
before. Of several equilibria the map holds the branch that starts at tendon angle zero and follows
the increasing angle. Two columns hold the stiffness at the clamp of a leg whose foot sticks, along
the leg and sideways, from `sticking_leg.py`.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import csv
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slot_core import config
from slot_core.arrays import checked
from slot_core.compiled import kernel
from slot_core.config import quantity
from slot_core.dynamics.clamp import couple
from slot_core.dynamics.contact import normal_force
from slot_core.dynamics.model import Model, build_model, planar_leg
from slot_core.dynamics.planar.elimination import eliminate, follow, substitute
from slot_core.dynamics.planar.leg import load_leg
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.legs.sticking_leg import StickingLeg
from slot_core.progress import Tell, untold
from slot_core.robot import Array, RobotParameters

COLUMNS = (
    "theta_deg",
    "height_m",
    "force_N",
    "slope_N_per_rad",
    "stiffness_N_per_m",
    "contact_x_m",
    "tension_N",
    "foot_m_per_rad",
    "foot_m_per_m",
    "longitudinal_N_per_m",
    "sideways_N_per_m",
)
TOLERANCE = 1e-11  # m, last Newton correction of a node
ITERATIONS = 2000
# Stages of the pseudo time stepping: reciprocal step, 1/s, and the correction (m) that ends a
# stage. The short steps of the first stage stay on the branch; the second one is nearly Newton's
# method.
STAGES = ((20.0, 1e-6), (1e-3, TOLERANCE))


@dataclass(frozen=True)
class LegMapSettings:
    """Grid of the leg map; substeps is the number of angle steps between two points of the grid."""

    nodes: int = quantity("nodes of the leg", "", 4, 401)
    angles: int = quantity("tendon angles from zero to the largest", "", 2, 1000)
    heights: int = quantity("clamp heights from the lowest to the highest", "", 2, 1000)
    height_min: float = quantity("lowest clamp height", "m", 0.0, 1.0)
    height_max: float = quantity("highest clamp height", "m", 0.0, 1.0)
    substeps: int = quantity("angle steps between two points of the grid", "", 1, 1000)


class NoEquilibriumError(RuntimeError):
    """No equilibrium was found; the message gives tendon angle and height."""


class LegEquilibrium(NamedTuple):
    """Equilibrium of a leg on the floor."""

    force: float  # N, vertical force of the floor on the leg
    slope: float  # N/rad, d force / d tendon angle
    stiffness: float  # N/m, d force / d clamp height
    contact_x: float  # m from the clamp, centre of pressure; without contact the tip
    tension: float  # N, of the tendon
    node: Array  # (N, 2) m from the clamp, x and z
    # Outward shift of the material on the floor, averaged by pressure, with angle (m/rad) and
    # height (m/m); zero without contact. Where a leg rolls, the material shifts less than the
    # contact.
    foot_slope: float
    foot_rise: float


class StaticLeg:
    """One leg on a frictionless floor, clamp horizontal; keeps its shape between solutions."""

    def __init__(self, robot: RobotParameters, nodes: int):
        changes = {
            "solver.legs": "planar",
            "solver.nodes": nodes,
            "floor.friction": (0.0, 0.0, 0.0, 0.0),
        }
        settings = config.replace(read_scene("flat"), changes)
        self.model: Model = build_model(robot, settings, read_servo())
        self._leg = planar_leg(nodes)
        self._leg.stage[:] = self.model.rod.node

    @property
    def node(self) -> Array:
        """(N, 2) present shape, m from the clamp, x and z; the next solution starts from it."""
        return self._leg.stage.copy()

    @node.setter
    def node(self, node: Array) -> None:
        self._leg.stage[:] = checked("node", node, self._leg.stage.shape)

    def solve(self, angle: float, height: float) -> LegEquilibrium:
        """Equilibrium at a tendon angle (rad) and a clamp height (m), from the present shape.

        Raises NoEquilibriumError where the iteration does not converge, ValueError for an angle or
        height that is not finite.
        """
        _, height = checked("angle, height", (angle, height), (2,)).tolist()
        self._leg.angle[0] = angle
        for inv, tolerance in STAGES:
            change = relax(self.model, self._leg, height, inv, tolerance, ITERATIONS)
        if not change <= TOLERANCE:
            raise NoEquilibriumError(
                f"leg at {math.degrees(angle):.3f} deg, {height:.4f} m: last correction of a node"
                f" {change:.1e} m, limit {TOLERANCE:.0e} m"
            )
        out = np.zeros(2)
        pressure(self.model, self._leg, height, out)
        slope, foot_slope = respond(self.model, self._leg, height, 0.0, 1.0)
        stiffness, foot_rise = respond(self.model, self._leg, height, 1.0, 0.0)
        tension = float(self._leg.pull[0])
        feet = foot_slope, foot_rise
        return LegEquilibrium(out[0], slope, stiffness, out[1], tension, self.node, *feet)


@kernel
def relax(model, leg, height, inv, tolerance, iterations):
    """Take pseudo time steps of 1/inv (s) from the present shape at rest.

    Stops at a correction of `tolerance` (m) or after `iterations` steps; returns the last
    correction, m.
    """
    leg.motion[:] = 0.0
    for i in range(3):
        for k in range(3):
            leg.field[k, i] = 1.0 if i == k else 0.0
        leg.field[3, i] = model.gravity[i]
    stage, velocity, held = leg.stage, leg.velocity, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    leg.rate[0] = 0.0
    change = 0.0
    for _ in range(iterations):
        velocity[:] = 0.0
        leg.before[:] = 0.0
        load_leg(model, leg, 0.0)
        eliminate(model, leg, inv, (0.0, 0.0, height))
        couple(model.tendon, leg, inv)
        substitute(leg, held, inv)
        change = 0.0
        for i in range(stage.shape[0]):
            dx, dz = velocity[i, 0] / inv, velocity[i, 2] / inv
            stage[i, 0] += dx
            stage[i, 1] += dz
            change += dx * dx + dz * dz
        change = math.sqrt(change)  # a sum: a maximum could drop a NaN
        if change <= tolerance:
            break
    return change


@kernel
def pressure(model, leg, height, out):
    """Write out (2,): vertical force of the floor, N, and centre of pressure, m from the clamp."""
    force = moment = 0.0
    stage = leg.stage
    for i in range(model.floor.first, stage.shape[0]):
        normal = normal_force(model.floor.stiffness[i], 0.0, height + stage[i, 1], 0.0)
        force += normal
        moment += normal * stage[i, 0]
    out[0] = force
    out[1] = moment / force if force > 0.0 else stage[-1, 0]


@kernel
def respond(model, leg, height, rise, turn):
    """Linear response to a rise of the clamp (m) and a turn of the spool (rad).

    Returns the change of the floor's force, N, and the outward shift of the material on the floor
    averaged by pressure, m. Uses the last factorisation of `relax`, hence is exact while the same
    nodes touch the floor.
    """
    tendon, F = model.tendon, leg.form
    stiffness = tendon.stiffness if leg.pull[0] > 0.0 else 0.0
    pull = F[6, 1] * rise + tendon.spool_radius * turn
    tension = pull * stiffness / (1.0 - stiffness * F[6, 6])
    X, q = (0.0, rise, 0.0), (0.0, 0.0, 0.0, tension, 0.0)
    force = shift = weight = 0.0
    for i in range(leg.back.shape[0]):
        X = follow(leg, i, X, q)
        gap = height + leg.stage[i + 1, 1]
        if gap < 0.0:
            force -= model.floor.stiffness[i + 1] * X[1]
            shift -= model.floor.stiffness[i + 1] * gap * X[0]
            weight -= model.floor.stiffness[i + 1] * gap
    return force, shift / weight if weight > 0.0 else 0.0


def tabulate(robot: RobotParameters, grid: LegMapSettings, tell: Tell = untold) -> Array:
    """Leg map, (angles x heights, 11), columns and units of `COLUMNS`; the height varies fastest.

    Raises NoEquilibriumError.
    """
    angles = np.linspace(0.0, robot.tendon.angle_max, grid.angles)
    heights = np.linspace(grid.height_min, grid.height_max, grid.heights)
    columns = []
    resting = StaticLeg(robot, grid.nodes)
    for k, height in enumerate(heights[::-1]):
        # Lower the slack leg, then pull the tendon at each height.
        tell(k / len(heights))
        resting.solve(0.0, height)
        columns.append(_rows_at_height(robot, grid, resting.node, height, angles))
    return np.stack(columns[::-1], axis=1).reshape(-1, len(COLUMNS))


def _rows_at_height(
    robot: RobotParameters, grid: LegMapSettings, node: Array, height: float, angles: Array
) -> Array:
    """(angles, 11) rows of the map at one height (m), from the shape (N, 2) at angle zero."""
    leg, stuck = StaticLeg(robot, grid.nodes), StickingLeg(robot, grid.nodes)
    leg.node = node
    rows = []
    for before, angle in zip([0.0, *angles], angles):
        for between in np.linspace(before, angle, grid.substeps + 1)[1:]:
            here = leg.solve(between, height)
        numbers = (here.force, here.slope, here.stiffness, here.contact_x, here.tension)
        feet = (here.foot_slope, here.foot_rise)
        held = stuck.stiffness(here.node, angle, height)
        rows.append((math.degrees(angle), height, *numbers, *feet, held[0, 0], held[1, 1]))
    return np.array(rows)


def write(path: Path, table: Array) -> None:
    """Write the map as CSV with a line of column names; raises OSError."""
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([f"{value:.6g}" for value in row] for row in table)
