"""A rollout MPC, and recorded ticks of a robot that walks with it."""

import pytest
from nominal_walk import ROBOT, SETTINGS, WALK

from slot_core.rollout_mpc.rollout_mpc import RolloutMpc
from slot_core.simulation.closed_loop import ClosedLoop


@pytest.fixture
def policy():
    return RolloutMpc(ROBOT, SETTINGS, lambda: 0.0)


@pytest.fixture(scope="session")
def walking():
    """Ticks of a robot that starts to walk from the posture `stand`."""
    return list(ClosedLoop("flat", "walk", WALK, 1, "rollout_mpc").run(60))
