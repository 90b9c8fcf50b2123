"""Rollouts of the robot on tabulated legs: one call simulates many plans from one state."""

# mypy: disable-error-code="no-untyped-def"
# ruff: noqa: PLR0917 - kernels take their arguments by position

from __future__ import annotations

import math

from slot_core.compiled import helper, kernel
from slot_core.dynamics.handle import contents
from slot_core.elementary import cos, sin
from slot_core.geometry import roll_pitch_yaw
from slot_core.legs.tabulated_kernels import divergence_of, one_step


@kernel
def roll_out(
    machine, start, side_rate, plans, angle_max, cycles, steps, pose, force, foot
):
    """Simulate every plan from the state `start` (m,) and the feet's `side_rate` (4,), m/s.

    plans: (P, n + 1, 4) rad, tendon angles at the stages 0 .. n, linear between them; the servos
    get them `cycles` times a stage, each time for `steps` steps. Writes pose (P, n, 6), roll,
    pitch, yaw (rad), x, y, z (m) at the stages 1 .. n, and force (P, n, 4, 3), N, of the floor on
    the feet and foot (P, n, 4, 3), m, their places, in odom; they are NaN from a divergence on. The
    state after the last plan stays.
    """
    model, legs, state, feet, work, scheme = contents(machine)
    for p in range(plans.shape[0]):
        for i in range(start.size):
            state.buffer[i] = start[i]
        for leg in range(4):
            feet.side_rate[leg] = side_rate[leg]
        diverged = False
        for k in range(plans.shape[1] - 1):
            for c in range(cycles):
                _command(feet, plans[p, k], plans[p, k + 1], c / cycles, angle_max)
                for _ in range(steps):
                    if not diverged:
                        one_step(model, legs, state, feet, work, scheme)
                        diverged = divergence_of(state, model.speed_limit) >= 0
            _record(pose[p, k], force[p, k], foot[p, k], legs, state, feet, diverged)


@kernel
def set_torso(machine, known, state):
    """Take the state `known` (m,) with the torso of an estimate (12,).

    Its rotation is Rz(yaw) Ry(pitch) Rx(roll).
    """
    torso = contents(machine)[2]
    for i in range(known.size):
        torso.buffer[i] = known[i]
    cr, cp, cy = cos(state[0]), cos(state[1]), cos(state[2])
    sr, sp, sy = sin(state[0]), sin(state[1]), sin(state[2])
    r = torso.rotation
    r[0, 0], r[0, 1], r[0, 2] = cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr
    r[1, 0], r[1, 1], r[1, 2] = sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr
    r[2, 0], r[2, 1], r[2, 2] = -sp, cp * sr, cp * cr
    w = state[6:9]
    for i in range(3):
        torso.position[i], torso.velocity[i] = state[3 + i], state[9 + i]
        torso.rate[i] = r[0, i] * w[0] + r[1, i] * w[1] + r[2, i] * w[2]


@helper
def _command(feet, here, there, share, angle_max):
    """Give the servos the angles between two stages."""
    for leg in range(4):
        goal = here[leg] + share * (there[leg] - here[leg])
        feet.command[leg] = min(max(goal, 0.0), angle_max)


@helper
def _record(pose, force, foot, legs, state, feet, diverged):
    """Write pose, forces and places of the feet, or NaN."""
    r, nan = state.rotation, math.nan
    pose[0], pose[1], pose[2] = (nan, nan, nan) if diverged else roll_pitch_yaw(r)
    for i in range(3):
        pose[3 + i] = nan if diverged else state.position[i]
    for leg in range(4):
        c, a, b, node = (
            legs.clamps[leg],
            legs.outward[leg],
            legs.left[leg],
            state.node[leg, 0],
        )
        x, y, z = (
            c[0] + node[0] * a[0] + node[1] * b[0],
            c[1] + node[0] * a[1] + node[1] * b[1],
            c[2] + node[0] * a[2] + node[1] * b[2] + node[2],
        )
        for i in range(3):
            place = state.position[i] + r[i, 0] * x + r[i, 1] * y + r[i, 2] * z
            foot[leg, i] = nan if diverged else place
            force[leg, i] = nan if diverged else feet.force[leg, i]
