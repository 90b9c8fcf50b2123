"""One leg on a floor with friction, its clamp held horizontal, while its tendon is pulled slowly.

The equations are those of the robot with the torso at rest, integrated with backward Euler:

    M (V - V_n) / tau = F(x_n + tau V, V),      x_{n+1} = x_n + tau V.

With friction the force depends on the history of the motion. The leg starts at rest on a
frictionless floor with its tendon slack; each call of `pull` continues the motion. `leg_map.py`
solves the leg without friction. The leg is planar: loads in its plane neither bend it sideways nor
twist it.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math

import numpy as np

from slot_core import config
from slot_core.arrays import checked
from slot_core.compiled import helper, kernel
from slot_core.dynamics.clamp import couple
from slot_core.dynamics.contact import normal_force
from slot_core.dynamics.model import Model, build_model, planar_leg
from slot_core.dynamics.planar.elimination import eliminate, substitute
from slot_core.dynamics.planar.leg import load_leg
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.legs.leg_map import NoEquilibriumError, StaticLeg
from slot_core.robot import Array, RobotParameters

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

    def __init__(self, robot: RobotParameters, nodes: int, friction: float, height: float):
        changes = {"solver.legs": "planar", "solver.nodes": nodes, "floor.friction_law": "viscous"}
        settings = config.replace(read_scene("flat"), changes)
        self.height = height  # m, checked by `StaticLeg`
        friction = float(checked("friction", friction, ()))
        self.model: Model = build_model(robot, settings, read_servo())
        self._leg = planar_leg(nodes)
        self._start = np.zeros((nodes, 2)), np.zeros((nodes, 3))
        self._leg.friction[:] = friction
        self._leg.field[:3] = np.eye(3)
        self._leg.field[3] = self.model.gravity
        resting = StaticLeg(robot, nodes)
        self._leg.stage[:] = resting.solve(0.0, height).node

    @property
    def node(self) -> Array:
        """(N, 2) present shape, m from the clamp, x and z."""
        return self._leg.stage.copy()

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
        turn = (angle - start) / steps
        change = turn_spool(self.model, self._leg, self._start, self.height, turn, steps)
        if not change <= LIMIT:
            raise NoEquilibriumError(
                f"leg at {math.degrees(self._leg.angle[0]):.3f} deg, {self.height:.4f} m:"
                f" last correction of a node {change:.1e} m, limit {LIMIT:.0e} m"
            )
        self._leg.angle[0] = angle  # removes the rounding of the sum
        return float(floor_force(self.model, self._leg, self.height))


@kernel
def turn_spool(model, leg, start, height, turn, steps):
    """Take steps of STEP that turn the spool by `turn` (rad) each; returns the last correction, m.

    start: scratch space for the nodes (N, 2) and velocities (N, 3) at the start of a step.
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
                change = take_step(model, leg, height, STEP / substeps)
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
    """Copy nodes (N, 2) and their velocities (N, 3)."""
    for i in range(node.shape[0]):
        node[i, 0], node[i, 1] = from_node[i, 0], from_node[i, 1]
        for k in range(3):
            velocity[i, k] = from_velocity[i, k]


@helper
def take_step(model, leg, height, tau):
    """Backward Euler step of tau (s) at the leg's tendon angle; returns the last correction, m."""
    stage, velocity, base, before = leg.stage, leg.velocity, leg.base, leg.before
    held = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    for i in range(stage.shape[0]):
        base[i, 0], base[i, 1] = stage[i, 0], stage[i, 1]
        for k in range(3):
            before[i, k] = velocity[i, k]
    change = 0.0
    for _ in range(ITERATIONS):
        load_leg(model, leg, 0.0)
        eliminate(model, leg, 1.0 / tau, (0.0, 0.0, height))
        couple(model.tendon, leg, 1.0 / tau)
        substitute(leg, held, 1.0 / tau)
        change = 0.0
        for i in range(stage.shape[0]):
            x, z = base[i, 0] + tau * velocity[i, 0], base[i, 1] + tau * velocity[i, 2]
            change += (x - stage[i, 0]) ** 2 + (z - stage[i, 1]) ** 2
            stage[i, 0], stage[i, 1] = x, z
        change = math.sqrt(change)  # a sum: a maximum could drop a NaN
        if change <= TOLERANCE:
            break
    return change


@kernel
def floor_force(model, leg, height):
    """Vertical force of the floor on the leg at its present shape and velocity, N."""
    force, floor = 0.0, model.floor
    for i in range(floor.first, leg.stage.shape[0]):
        gap = height + leg.stage[i, 1]
        force += normal_force(floor.stiffness[i], floor.damping[i], gap, leg.velocity[i, 2])
    return force
