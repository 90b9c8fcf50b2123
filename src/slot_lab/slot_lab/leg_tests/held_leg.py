"""One leg on a floor with friction, its clamp held horizontal, while its tendon is pulled slowly.

With friction the force depends on the history of the motion. The leg starts at rest on a
frictionless floor with its tendon slack; each call of `pull` continues the motion, in the steps of
`level_leg.py`. `leg_map.py` solves the leg without friction.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math

import numpy as np

from slot_core.arrays import Array, checked
from slot_core.compiled import helper, kernel
from slot_core.dynamics.algebra import put, row
from slot_core.robot import RobotParameters
from slot_lab.leg_tests.leg_map import StaticLeg
from slot_lab.leg_tests.level_leg import (
    NoEquilibriumError,
    at_nodes,
    level_leg,
    take_step,
)

STEP = 1e-3  # s; half of it changes the force by less than 1e-3 N
ITERATIONS = 50  # of a step, at most
TOLERANCE = 1e-8  # m, correction of the nodes that ends the iteration
LIMIT = 1e-4  # m, largest last correction that is accepted
HALVINGS = 6  # of a step whose last correction is above the limit, at most


class HeldLeg:
    """One leg on a floor with friction, its clamp at a height (m); keeps its motion between calls.

    nodes: of the leg. friction: Coulomb coefficient, viscously regularised. Raises
    NoEquilibriumError where the leg has no equilibrium at the start.
    """

    def __init__(
        self, robot: RobotParameters, nodes: int, friction: float, height: float
    ):
        self.height = height  # m, checked by `StaticLeg`
        self.model, self._leg = level_leg(
            robot, nodes, {"friction_law": "viscous"}
        )
        self._leg.friction[:] = checked("friction", friction, ())
        self._leg.stage[:, ::2] = (
            StaticLeg(robot, nodes).solve(0.0, height).node
        )
        self._start = np.zeros((2, nodes, 3))

    @property
    def node(self) -> Array:
        """(N, 2) present shape, m from the clamp, x and z."""
        return self._leg.stage[:, ::2].copy()

    def pull(self, angle: float, rate: float) -> float:
        """Turn the spool to an angle (rad) at a rate (rad/s).

        Returns the vertical force of the floor in the last step, N. Raises NoEquilibriumError where
        a step does not converge, ValueError for values that are not finite or a rate not above 0.
        """
        angle, rate = checked("angle, rate", (angle, rate), (2,)).tolist()
        if rate <= 0.0:
            raise ValueError(f"rate {rate} rad/s must be above 0")
        start = float(self._leg.angle[0])
        steps = max(1, math.ceil(abs(angle - start) / (rate * STEP)))
        change = turn_spool(
            self.model,
            self._leg,
            self._start,
            self.height,
            (angle - start) / steps,
            steps,
        )
        if not change <= LIMIT:
            raise NoEquilibriumError(
                f"leg at {math.degrees(self._leg.angle[0]):.3f} deg, {self.height:.4f} m:"
                f" last correction of a node {change:.1e} m, limit {LIMIT:.0e} m"
            )
        self._leg.angle[0] = angle  # removes the rounding of the sum
        floor, gap = self.model.floor, self.height + self._leg.stage[:, 2]
        damped = at_nodes(floor.damping) * self._leg.velocity[:, 2]
        normal = np.maximum(0.0, -at_nodes(floor.stiffness) * gap - damped)
        return float(normal[gap < 0.0].sum())


@kernel
def turn_spool(model, leg, start, height, turn, steps):
    """Take steps of STEP that turn the spool by `turn` (rad) each; returns the last correction, m.

    start: (2, N, 3) scratch space for the nodes and velocities at the start of a step.
    A step whose last correction is above LIMIT is repeated in 2, 4, ... 2^HALVINGS substeps. If it
    stays above, the motion ends with this step.
    """
    change = 0.0
    for _ in range(steps):
        begin = leg.angle[0]
        copy_motion(start[0], start[1], leg.stage, leg.velocity)
        for halving in range(HALVINGS + 1):
            substeps = 2**halving
            for k in range(substeps):
                leg.angle[0] = begin + turn * (k + 1) / substeps
                change = take_step(
                    model, leg, height, STEP / substeps, ITERATIONS, TOLERANCE
                )
                if not change <= LIMIT:
                    break
            if change <= LIMIT:
                break
            if halving < HALVINGS:
                copy_motion(leg.stage, leg.velocity, start[0], start[1])
        if not change <= LIMIT:
            break
    return change


@helper
def copy_motion(node, velocity, from_node, from_velocity):
    """Copy nodes and their velocities, (N, 3) each."""
    for i in range(node.shape[0]):
        put(node, i, row(from_node, i))
        put(velocity, i, row(from_velocity, i))
