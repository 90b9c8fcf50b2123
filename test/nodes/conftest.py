"""Fixtures of tests of the graph on simulated time."""

import pytest
from rig import maker
from simulated_rig import SimulatedRig
from stub_supervisor import stub  # noqa: F401 - a fixture

simulate = maker(SimulatedRig)  # one at a time


@pytest.fixture
def walking(rig):
    """The rig of the module, whose robot walks."""
    rig.walk_steadily()
    return rig
