"""Fixtures for tests that start the graph as processes."""

import os
import re
from pathlib import Path

import pytest

from slot_bringup import run
from slot_bringup.graph import read_graph


@pytest.fixture(scope="session", autouse=True)
def domain():
    """A ROS domain for every worker: graphs under test do not hear each other."""
    worker = re.sub(r"\D", "", os.environ.get("PYTEST_XDIST_WORKER", "0"))
    before = os.environ.get("ROS_DOMAIN_ID")
    os.environ["ROS_DOMAIN_ID"] = str(61 + int(worker))
    yield
    if before is None:
        del os.environ["ROS_DOMAIN_ID"]
    else:
        os.environ["ROS_DOMAIN_ID"] = before


def record(bag: Path, *arguments: str) -> Path:
    """Run the graph with a bag and return its directory."""
    graph = read_graph()
    run.run(run.parse([*arguments, "--bag", str(bag)], graph), graph, bag)
    return bag


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """Bag of a walk of 5 s in lockstep with seed 3."""
    directory = tmp_path_factory.mktemp("walk")
    return record(directory / "bag", "--lockstep", "--duration", "5", "--seed", "3")
