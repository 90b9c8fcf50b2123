"""A predictive policy, and recorded ticks of a robot that walks with it."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core.geometry import rpy_of
from slot_core.predictive.predictive import Predictive
from slot_core.predictive.settings import read_predictive
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop

ROBOT, SETTINGS = read_robot(), read_predictive()
WALK = np.array([0.05, 0.0, 0.0])


def torso_of(model, start):
    """State (12,) of the torso of a nominal robot, as of an estimate."""
    torso = model.robot.state
    torso.buffer[:] = start.buffer
    rpy, omega = rpy_of(Rotation.from_matrix(torso.rotation)), torso.rotation @ torso.rate
    return np.concatenate([rpy, torso.position, omega, torso.velocity])


@pytest.fixture
def policy():
    return Predictive(ROBOT, SETTINGS, lambda: 0.0)


@pytest.fixture(scope="session")
def walking():
    """Ticks of a robot that starts to walk from the posture `stand`."""
    return list(ClosedLoop("flat", "walk", WALK, 1, "predictive").run(60))
