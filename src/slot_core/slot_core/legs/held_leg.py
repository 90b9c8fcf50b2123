"""One leg with friction whose clamp is held horizontal, while its tendon is pulled slowly.

The equations are those of the whole robot with the torso at rest, stepped with backward Euler:

    M (V - V_n) / tau = F(x_n + tau V, V),      x_{n+1} = x_n + tau V.

Friction makes the force depend on the way: the leg starts at rest without friction, tendon slack,
and each later point continues the motion. `leg_map.py` solves the leg without friction.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np

from slot_core import config
from slot_core.compiled import helper, kernel
from slot_core.dynamics.contact import normal_force
from slot_core.dynamics.elimination import couple, eliminate, substitute
from slot_core.dynamics.integrator import load_leg
from slot_core.dynamics.model import Model, build_model, leg_space
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.legs.leg_map import NoEquilibriumError, StaticLeg
from slot_core.robot import Array, Robot

STEP = 1e-3  # s; half of it changes the force by less than 1e-3 N
ITERATIONS = 50
TOLERANCE = 1e-8  # m, last correction of a node
LIMIT = 1e-4  # m, last correction that is accepted
HALVINGS = 6


class HeldLeg:
    """One leg on a floor with friction, its clamp held at a height (m); remembers its motion."""

    def __init__(self, robot: Robot, nodes: int, friction: float, height: float):
        changes = {"solver.nodes": nodes, "floor.friction_law": "viscous"}
        settings = config.replace(read_scene("flat"), changes)
        self.height = height
        self.model: Model = build_model(robot, settings, read_servo())
        self._leg = leg_space(nodes)
        self._leg.friction[:] = friction
        self._leg.field[:3] = np.eye(3)
        self._leg.field[3] = self.model.gravity
        resting = StaticLeg(robot, nodes)
        self._leg.stage[:] = resting.solve(0.0, height).node

    @property
    def node(self) -> Array:
        """(N, 2) present shape, m from the clamp."""
        return self._leg.stage.copy()

    def pull(self, angle: float, rate: float) -> float:
        """Turn the spool to an angle (rad) at a rate (rad/s); the floor's force there, N.

        The force is vertical, that of the last step. Raises NoEquilibriumError when the motion is
        lost.
        """
        start = float(self._leg.angle[0])
        steps = max(1, math.ceil(abs(angle - start) / (rate * STEP)))
        change = haul(self.model, self._leg, self.height, (angle - start) / steps, steps)
        if not change <= LIMIT:
            raise NoEquilibriumError(
                f"leg at {math.degrees(self._leg.angle[0]):.3f} deg, {self.height:.4f} m:"
                f" a node still moves {change:.1e} m in a step, limit {LIMIT:.0e} m"
            )
        self._leg.angle[0] = angle  # without the rounding of the sum
        return float(floor_force(self.model, self._leg, self.height))


@kernel
def haul(model, leg, height, turn, steps):
    """Turn the spool in steps of `turn` (rad); returns the last correction of the last step, m.

    A step whose correction is above the limit is taken again in 2, 4, ... 2^HALVINGS pieces; one
    that stays above is the last.
    """
    change = 0.0
    for _ in range(steps):
        begin = leg.angle[0]
        keep(leg.node, leg.node_velocity, leg.stage, leg.velocity)
        for halving in range(HALVINGS + 1):
            pieces = 2**halving
            for k in range(pieces):
                leg.angle[0] = begin + turn * (k + 1) / pieces
                change = creep(model, leg, height, STEP / pieces)
                if not change <= LIMIT:
                    break
            if change <= LIMIT:
                break
            if halving < HALVINGS:
                keep(leg.stage, leg.velocity, leg.node, leg.node_velocity)
        if not change <= LIMIT:
            break
    return change


@helper
def keep(place, speed, from_place, from_speed):
    """Copy nodes and their velocities."""
    for i in range(place.shape[0]):
        place[i, 0], place[i, 1] = from_place[i, 0], from_place[i, 1]
        for k in range(3):
            speed[i, k] = from_speed[i, k]


@helper
def creep(model, leg, height, tau):
    """One step of tau (s) with the clamp at rest, at the leg's tendon angle; last correction, m."""
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
        change = math.sqrt(change)  # a sum, because a maximum could lose a NaN
        if change <= TOLERANCE:
            break
    return change


@kernel
def floor_force(model, leg, height):
    """Vertical force of the floor on the leg in its present motion, N."""
    force, floor = 0.0, model.floor
    for i in range(floor.first, leg.stage.shape[0]):
        gap = height + leg.stage[i, 1]
        force += normal_force(floor.stiffness[i], floor.damping[i], gap, leg.velocity[i, 2])
    return force
