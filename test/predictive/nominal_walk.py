"""The robot, the settings and the walk of the tests of the predictive policy."""

import numpy as np

from slot_core.geometry import rpy_of
from slot_core.predictive.settings import read_predictive
from slot_core.robot import read_robot

ROBOT, SETTINGS = read_robot(), read_predictive()
WALK = np.array([0.05, 0.0, 0.0])


def torso_of(model, start):
    """State (12,) of the torso of a nominal robot, as of an estimate."""
    torso = model.robot.state
    torso.buffer[:] = start.buffer
    rpy, omega = rpy_of(torso.rotation), torso.rotation @ torso.rate
    return np.concatenate([rpy, torso.position, omega, torso.velocity])
