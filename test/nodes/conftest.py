"""Fixtures of tests of the graph on simulated time."""

import pytest
from rig import Rig


@pytest.fixture(scope="module")
def simulate(tmp_path_factory):
    """A function that makes rigs, one at a time; their nodes end with the module."""
    made = []

    def make(**options):
        made.append(Rig(tmp_path_factory.mktemp("rig"), **options))
        return made[-1]

    yield make
    for rig in made:
        rig.close()


@pytest.fixture
def walking(rig):
    """The rig of the module, whose robot walks."""
    rig.walk()
    return rig
