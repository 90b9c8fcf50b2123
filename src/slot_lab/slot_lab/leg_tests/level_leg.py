"""One leg whose clamp is held level and at rest: its model, its arrays, and a step of its motion.

The robot's equations with the torso at rest, integrated with backward Euler:

    M (V - V_n) / tau = F(x_n + tau V, V),      x_{n+1} = x_n + tau V.

The simulation has the same leg (`dynamics/spatial`). Loads in its plane neither bend it sideways
nor twist it, to the last bit, so that it stays in its plane.
"""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.compiled import helper
from slot_core.dynamics.algebra import dot, plus, put, row
from slot_core.dynamics.model import Model, build_model, spatial_leg
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.spatial.elimination import couple, eliminate, substitute
from slot_core.dynamics.spatial.leg import SpatialLeg, hold_clamp, load_leg
from slot_core.dynamics.spatial.strain import point_along
from slot_core.refusal import InputError
from slot_core.robot import RobotParameters

HELD = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)  # increments of the torso


class NoEquilibriumError(InputError):
    """No equilibrium was found; the message gives tendon angle and height."""


def level_leg(
    robot: RobotParameters, nodes: int, floor: Mapping[str, Any]
) -> tuple[Model, SpatialLeg]:
    """Model and arrays of a leg of `nodes` nodes, at rest in its natural shape.

    floor: changes of the floor of the scene `flat`, by name.
    """
    changes = {f"floor.{name}": value for name, value in floor.items()} | {
        "solver.nodes": nodes
    }
    model = build_model(
        robot, config.replace(read_scene("flat"), changes), read_servo()
    )
    leg = spatial_leg(nodes, (), len(model.floor.stiffness))
    leg.stage[:, ::2] = model.rod.node
    leg.segments.director[:] = 0.0, -1.0, 0.0
    leg.field[:3] = np.eye(3)
    leg.field[3] = model.gravity
    return model, leg


def at_nodes(contact: Array) -> Array:
    """(N,) sums over the contact points (P,) at each node of a leg, as of their stiffness, N/m."""
    # of begin and end of the segments
    ends = contact.reshape(-1, 2, 2).sum(axis=-1)
    return np.append(ends[:, 0], 0.0) + np.append(0.0, ends[:, 1])


@helper
def linearise(model, leg, inv, height):
    """Forces of the leg as it is and their elimination, its clamp at a height (m); inv = 1/tau."""
    point_along(leg.segments, leg.stage)
    hold_clamp(leg)
    load_leg(model, leg, 0.0)
    eliminate(model, leg, inv, (0.0, 0.0, height))
    couple(model.tendon, leg, inv)


@helper
def take_step(model, leg, height, tau, iterations, tolerance):
    """Backward Euler step of tau (s) at the leg's tendon angle; returns the last correction, m."""
    stage, velocity, base, before = (
        leg.stage,
        leg.velocity,
        leg.base,
        leg.before,
    )
    for i in range(stage.shape[0]):
        put(base, i, row(stage, i))
        put(before, i, row(velocity, i))
    change = 0.0
    for _ in range(iterations):
        linearise(model, leg, 1.0 / tau, height)
        substitute(leg, HELD, 1.0 / tau)
        change = 0.0
        for i in range(stage.shape[0]):
            place = plus(row(base, i), tau, row(velocity, i))
            moved = plus(place, -1.0, row(stage, i))
            put(stage, i, place)
            change += dot(moved, moved)
        change = math.sqrt(change)  # a sum: a maximum could drop a NaN
        if change <= tolerance:
            break
    return change
