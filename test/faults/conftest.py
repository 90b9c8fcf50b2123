"""Fixtures for tests that harm a running graph."""

import os

import pytest
from rig import Rig

DOMAINS = 100  # beyond, the ports of DDS run into those that the system hands out


@pytest.fixture(scope="session", autouse=True)
def domain():
    """A ROS domain for every process that runs tests: their graphs do not hear each other."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % DOMAINS))
        yield


@pytest.fixture(scope="module")
def make_rig(tmp_path_factory):
    """A function that makes rigs, whose nodes have all ended when the module has."""
    made = []

    def make(**options):
        made.append(Rig(tmp_path_factory.mktemp("rig"), **options))
        return made[-1]

    yield make
    for rig in made:
        rig.close()
