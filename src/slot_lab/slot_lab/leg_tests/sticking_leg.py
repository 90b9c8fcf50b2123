"""Stiffness at the clamp of a standing leg whose foot sticks to the floor.

About the equilibrium of `leg_map.py`, in the leg's plane, a leg with its foot stuck answers small
displacements X and small rotations Phi of its clamp with the force and moment

    (f, m) = -K (X, Phi),      K (6 x 6) = `leg.reduced` without inertia.

Each point that touches the floor has its normal and its tangential stiffness: both edges of the
foot hold, so that it neither rolls nor turns in its place. That is so up to 1 to 4 mm sideways.
Then edges slip or lift: at 10 mm and friction 0.4 a leg of 63 to 110 deg that carries 4 to 9 N has
0.37 to 0.47 of the force that K says. The spool does not turn. Of a leg above the floor it is the
stiffness with its lowest node stuck, which is the limit for a leg that just touches.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

from slot_core.arrays import Array, checked
from slot_core.compiled import kernel
from slot_core.robot import RobotParameters
from slot_lab.leg_tests.level_leg import level_leg, linearise

# 1/s, reciprocal of a step so long that inertia and damping, some kg and some N s/m times powers
# of it, are below the rounding of the stiffness.
AT_REST = 1e-6
TOUCH = 1e-9  # m into the floor of the lowest node of a leg above it


class StickingLeg:
    """One leg of `nodes` nodes, clamp horizontal, on the floor of the scene `flat`."""

    def __init__(self, robot: RobotParameters, nodes: int):
        self.model, self._leg = level_leg(robot, nodes, {"friction_law": "bristle"})
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


@kernel
def tangent(model, leg, height):
    """Write the leg's form at its clamp, at rest with the clamp level at a height (m)."""
    linearise(model, leg, AT_REST, height)
