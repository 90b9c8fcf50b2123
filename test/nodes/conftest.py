"""Fixtures of tests of the graph on simulated time."""

import pytest
from real_graph import domain  # noqa: F401 - a fixture
from simulated_rig import SimulatedRig
from stub_supervisor import stub  # noqa: F401 - a fixture


@pytest.fixture(scope="module")
def simulate(tmp_path_factory):
    """A function that makes the graph on simulated time; one at a time."""
    made = []

    def make(**options):
        made.append(SimulatedRig(tmp_path_factory.mktemp("rig"), **options))
        return made[-1]

    yield make
    for rig in made:
        rig.close()
