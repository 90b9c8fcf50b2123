"""Fixtures for tests that start the graph as processes."""

import os

import pytest
from graph_bag import record

DOMAINS = 100  # beyond, the ports of DDS run into those that the system hands out


@pytest.fixture(scope="session", autouse=True)
def domain():
    """A ROS domain for every process that runs tests: their graphs do not hear each other."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % DOMAINS))
        yield


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """Bag of a walk of 5 s in lockstep with seed 3."""
    directory = tmp_path_factory.mktemp("walk")
    return record(directory / "bag", "--lockstep", "--duration", "5", "--seed", "3")
