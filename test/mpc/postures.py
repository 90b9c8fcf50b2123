"""Postures and previews for the MPC on tendon angles."""

import dataclasses

import numpy as np

from benchmarks.mpc.cases import DT, standing
from slot_core.control.force_map import read_springs
from slot_core.estimation.estimate import Estimate
from slot_core.gait.gait import GaitCommand
from slot_core.mpc.settings import read_mpc
from slot_core.robot import read_robot

ROBOT = read_robot()
H = read_mpc().horizon
SPRINGS = read_springs()
HOME = np.array([0.04, 0.0, 0.0])  # z, roll, pitch


def state(z=0.04, roll=0.0, pitch=0.0):
    x = np.zeros(12)
    x[[5, 0, 1]] = z, roll, pitch
    return x


def preview(start=HOME, end=None, tick=0, **changes):
    """A posture that moves from `start` to `end` (3,) over the horizon, at its tendon angles."""
    rows = np.linspace(start, start if end is None else end, H + 1)
    reference = np.zeros((H + 1, 12))
    reference[:, [5, 0, 1]] = rows
    height = ROBOT.clamp_heights(*np.transpose(rows))
    share = np.full(4, ROBOT.weight / 4)
    angle = np.array([SPRINGS.angle(share, row) for row in height])
    values = {
        "normal_force": SPRINGS.at(angle, height).force,
        "tendon_angle": angle,
        "reference": reference,
        "command": GaitCommand("stand", np.zeros(3), np.asarray(start)),
    }
    stamp = 10**9 + round(tick * DT * 1e9)
    return dataclasses.replace(standing(H + 1, **values | changes), stamp=stamp)


def known(*posture):
    """Estimate of a torso at rest, of state()."""
    return Estimate.exact(state(*posture))


CASES = {
    "at the reference": (state(), preview()),
    "too low": (state(0.034), preview()),
    "too high": (state(0.047, 0.01), preview()),
    "tilted": (state(0.041, 0.08, -0.06), preview()),
    "at zero forces": (state(0.055, 0.2, 0.1), preview()),
    "rising": (state(0.032), preview([0.032, 0, 0], [0.045, 0, 0])),
    "rolling": (state(0.05), preview([0.05, 0, 0], [0.05, 0.05, -0.03])),
    "near the fold": (state(0.055), preview([0.06, 0, 0])),
    "on the belly": (state(0.0165), preview([0.03, 0, 0])),
    "upside down": (state(0.04, 3.0), preview()),
    "lifted": (state(0.12), preview()),
}
