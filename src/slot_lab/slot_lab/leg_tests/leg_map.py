"""Statics of one leg with a horizontal clamp: force and stiffness over tendon angle and height.

The floor has no friction, so that the force depends on angle and height alone and not on the motion
before. Of several equilibria the map holds the branch that starts at tendon angle zero and follows
the increasing angle. The last columns hold the stiffness of a leg whose foot sticks, over the
displacements of the foot along the leg, sideways, and its turn (`foot_stiffness`).
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import csv
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from slot_core.arrays import Array, checked
from slot_core.command_line import Tell, untold
from slot_core.compiled import kernel
from slot_core.config import quantity
from slot_core.dynamics.spatial.elimination import follow
from slot_core.legs.fingerprint import LEG, fingerprint
from slot_core.legs.leg_table import MADE_FOR
from slot_core.matrices import product
from slot_core.robot import RobotParameters
from slot_lab.leg_tests.level_leg import (
    NoEquilibriumError,
    at_nodes,
    level_leg,
    linearise,
    take_step,
)

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
    "sideways_N_per_rad",
    "turn_N_m_per_rad",
)
TOLERANCE = 1e-11  # m, last Newton correction of a node
ITERATIONS = 2000
# Stages of the pseudo time stepping: step, s, and the correction (m) that ends a stage. The short
# steps of the first stage stay on the branch; the second one is nearly Newton's method.
STAGES = ((0.05, 1e-6), (1000.0, TOLERANCE))


@dataclass(frozen=True)
class LegMapSettings:
    """Grid of the leg map; substeps is the number of angle steps between two points of the grid."""

    nodes: int = quantity("nodes of the leg", "", 4, 401)
    angles: int = quantity(
        "tendon angles from zero to the largest", "", 2, 1000
    )
    heights: int = quantity(
        "clamp heights from the lowest to the highest", "", 2, 1000
    )
    height_min: float = quantity("lowest clamp height", "m", 0.0, 1.0)
    height_max: float = quantity("highest clamp height", "m", 0.0, 1.0)
    substeps: int = quantity(
        "angle steps between two points of the grid", "", 1, 1000
    )


class LegEquilibrium(NamedTuple):
    """Equilibrium of a leg on the floor."""

    force: float  # N, vertical force of the floor on the leg
    slope: float  # N/rad, d force / d tendon angle
    stiffness: float  # N/m, d force / d clamp height
    # m from the clamp, centre of pressure; without contact the tip
    contact_x: float
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
        self.model, self._leg = level_leg(
            robot, nodes, {"friction": (0.0, 0.0, 0.0, 0.0)}
        )
        self._stiffness = at_nodes(self.model.floor.stiffness)

    @property
    def node(self) -> Array:
        """(N, 2) present shape, m from the clamp, x and z; the next solution starts from it."""
        return self._leg.stage[:, ::2].copy()

    @node.setter
    def node(self, node: Array) -> None:
        self._leg.stage[:, ::2] = checked(
            "node", node, (len(self._leg.stage), 2)
        )

    def solve(self, angle: float, height: float) -> LegEquilibrium:
        """Equilibrium at a tendon angle (rad) and a clamp height (m), from the present shape.

        Raises NoEquilibriumError where the iteration does not converge, ValueError for an angle or
        height that is not finite.
        """
        _, height = checked("angle, height", (angle, height), (2,)).tolist()
        self._leg.angle[0] = angle
        for tau, tolerance in STAGES:
            change = relax(
                self.model, self._leg, height, tau, tolerance, ITERATIONS
            )
        if not change <= TOLERANCE:
            raise NoEquilibriumError(
                f"leg at {math.degrees(angle):.3f} deg, {height:.4f} m: last correction of a node"
                f" {change:.1e} m, limit {TOLERANCE:.0e} m"
            )
        node = self.node
        normal = self._stiffness * np.maximum(0.0, -height - node[:, 1])
        force, contact = normal.sum(), node[-1, 0]
        if force > 0.0:
            contact = (normal * node[:, 0]).sum() / force
        # the last correction is no part of the response
        self._leg.back[:, :, 7] = 0.0
        slope, foot_slope = respond(
            self.model, self._leg, self._stiffness, height, 0.0, 1.0
        )
        stiffness, foot_rise = respond(
            self.model, self._leg, self._stiffness, height, 1.0, 0.0
        )
        return LegEquilibrium(
            force=float(force),
            slope=slope,
            stiffness=stiffness,
            contact_x=float(contact),
            tension=float(self._leg.pull[0]),
            node=node,
            foot_slope=foot_slope,
            foot_rise=foot_rise,
        )


@kernel
def relax(model, leg, height, tau, tolerance, iterations):
    """Take pseudo time steps of tau (s), each of one Newton iteration from rest.

    Stops at a correction of `tolerance` (m) or after `iterations` steps; returns the last
    correction, m.
    """
    change = 0.0
    for _ in range(iterations):
        leg.velocity[:] = 0.0
        change = take_step(model, leg, height, tau, 1, tolerance)
        if change <= tolerance:
            break
    return change


@kernel
def respond(model, leg, springs, height, rise, turn):
    """Linear response to a rise of the clamp (m) and a turn of the spool (rad).

    springs: (N,) N/m, stiffness of the floor at the nodes.

    Returns the change of the floor's force, N, and the outward shift of the material on the floor
    averaged by pressure, m. Uses the last factorisation of `relax`, hence is exact while the same
    nodes touch the floor.
    """
    tendon, F = model.tendon, leg.form
    stiffness = tendon.stiffness if leg.pull[0] > 0.0 else 0.0
    pull = F[6, 2] * rise + tendon.spool_radius * turn
    tension = pull * stiffness / (1.0 - stiffness * F[6, 6])
    shifted, turned = (0.0, 0.0, rise), (0.0, 0.0, 0.0)
    force = shift = weight = 0.0
    for k in range(leg.back.shape[0]):
        shifted, turned, _ = follow(leg, k, shifted, turned, tension)
        gap = height + leg.stage[k + 1, 2]
        if gap < 0.0:
            force -= springs[k + 1] * shifted[2]
            shift -= springs[k + 1] * gap * shifted[0]
            weight -= springs[k + 1] * gap
    return force, shift / weight if weight > 0.0 else 0.0


def tabulate(
    robot: RobotParameters, grid: LegMapSettings, tell: Tell = untold
) -> Array:
    """Leg map, (angles x heights, 13), columns and units of `COLUMNS`; the height varies fastest.

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
        columns.append(
            _rows_at_height(robot, grid, resting.node, height, angles)
        )
    return np.stack(columns[::-1], axis=1).reshape(-1, len(COLUMNS))


def _rows_at_height(
    robot: RobotParameters,
    grid: LegMapSettings,
    node: Array,
    height: float,
    angles: Array,
) -> Array:
    """(angles, 13) rows of the map at one height (m), from the shape (N, 2) at angle zero."""
    leg, stuck = StaticLeg(robot, grid.nodes), StickingLeg(robot, grid.nodes)
    leg.node = node
    rows = []
    for before, angle in zip([0.0, *angles], angles):
        for between in np.linspace(before, angle, grid.substeps + 1)[1:]:
            here = leg.solve(between, height)
        clamp = stuck.stiffness(here.node, angle, height)
        held = foot_stiffness(clamp, here.contact_x)
        rows.append(
            (
                math.degrees(angle),
                height,
                here.force,
                here.slope,
                here.stiffness,
                here.contact_x,
                here.tension,
                here.foot_slope,
                here.foot_rise,
                *held[[0, 1, 1, 2], [0, 1, 2, 2]],
            )
        )
    return np.array(rows)


def write(path: Path, table: Array, robot: RobotParameters) -> None:
    """Write the map as CSV with the robot's fingerprint and column names; raises OSError."""
    with path.open("w", newline="") as file:
        file.write(f"{MADE_FOR}{json.dumps(fingerprint(robot, LEG))}\n")
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([f"{value:.6g}" for value in row] for row in table)


# 1/s, reciprocal of a step so long that inertia and damping, some kg and some N s/m times powers
# of it, are below the rounding of the stiffness.
AT_REST = 1e-6
TOUCH = 1e-9  # m into the floor of the lowest node of a leg above it


class StickingLeg:
    """One leg of `nodes` nodes, clamp horizontal, whose foot sticks to the floor of `flat`.

    About an equilibrium of `StaticLeg`, in the leg's plane, it answers small displacements X and
    small rotations Phi of its clamp with the force and moment

        (f, m) = -K (X, Phi),      K (6 x 6) = `leg.reduced` without inertia.

    Each point that touches the floor has its normal and its tangential stiffness: both edges of
    the foot hold, so that it neither rolls nor turns in its place. That is so up to 1 to 4 mm
    sideways. Then edges slip or lift: at 10 mm and friction 0.4 a leg of 63 to 110 deg that carries
    4 to 9 N has 0.37 to 0.47 of the force that K says. The spool does not turn. Of a leg above the
    floor it is the stiffness with its lowest node stuck, the limit for a leg that just touches.
    """

    def __init__(self, robot: RobotParameters, nodes: int):
        self.model, self._leg = level_leg(
            robot, nodes, {"friction_law": "bristle"}
        )
        self._leg.friction[:] = 1.0  # any: points at rest are below every limit

    def stiffness(self, node: Array, angle: float, height: float) -> Array:
        """(6, 6) K over X (m) and Phi (rad), leg axes; N/m, N, N m/rad.

        node: (N, 2) equilibrium, m from the clamp, x and z, at a tendon angle (rad) and a clamp
        height (m). Raises ValueError for another shape, or values that are not finite.
        """
        node = checked("node", node, (len(self._leg.stage), 2))
        angle, height = checked("angle, height", (angle, height), (2,)).tolist()
        self._leg.stage[:, ::2] = node
        self._leg.angle[0] = angle
        tangent(self.model, self._leg, min(height, -node[:, 1].min() - TOUCH))
        return self._leg.reduced[:, :6].copy()


def foot_stiffness(stiffness: Array, x: float) -> Array:
    """Stiffness (3, 3) of a leg over its foot's displacements; N/m, N, N m/rad.

    stiffness: K (6, 6) of `StickingLeg.stiffness`; x: m, of the contact from the clamp. A foot that
    moves by xi along the leg and y sideways, and turns by phi about the vertical through it, is for
    the leg as a clamp that moves by X = (-xi, x phi - y, 0) and turns by Phi = (0, 0, -phi). With
    these as columns J (6, 3) it is J^T K J. Raises ValueError for other shapes.
    """
    K = checked("stiffness", stiffness, (6, 6))
    J = np.zeros((6, 3))
    J[0, 0] = J[1, 1] = J[5, 2] = -1.0
    J[1, 2] = checked("x", x, ())
    return product(J.T, product(K, J))


@kernel
def tangent(model, leg, height):
    """Write the leg's form at its clamp, at rest with the clamp level at a height (m)."""
    linearise(model, leg, AT_REST, height)
