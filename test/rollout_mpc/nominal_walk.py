"""The robot, the settings and the walk of the tests of the rollout MPC."""

import numpy as np

from slot_core.geometry import rpy_of
from slot_core.robot import read_robot
from slot_core.rollout_mpc.settings import read_rollout_mpc

ROBOT, SETTINGS = read_robot(), read_rollout_mpc()
WALK = np.array([0.05, 0.0, 0.0])


def torso_of(model, start):
    """State (12,) of the torso of a nominal robot, as of an estimate."""
    torso = model.robot.state
    torso.buffer[:] = start
    rpy, omega = rpy_of(torso.rotation), torso.rotation @ torso.rate
    return np.concatenate([rpy, torso.position, omega, torso.velocity])
