"""Recorded ticks of a robot that walks with the rollout MPC."""

import pytest
from nominal_walk import WALK

from slot_core.simulation.closed_loop import ClosedLoop


@pytest.fixture(scope="session")
def walking():
    """Ticks of a robot that starts to walk from the posture `stand`."""
    return list(ClosedLoop("flat", "walk", WALK, 1, "rollout_mpc").run(60))
