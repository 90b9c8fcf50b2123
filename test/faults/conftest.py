"""Fixtures for tests that inject faults into a running graph."""

import pytest
from real_graph import domain  # noqa: F401 - a fixture
from rig import Rig
from stub_supervisor import stub  # noqa: F401 - a fixture


@pytest.fixture(scope="module")
def make_rig(tmp_path_factory):
    """A function that makes rigs; their nodes end with the module."""
    made = []

    def make(**options):
        made.append(Rig(tmp_path_factory.mktemp("rig"), **options))
        return made[-1]

    yield make
    for rig in made:
        rig.close()
