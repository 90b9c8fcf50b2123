"""Fixtures for tests that start the graph as processes."""

import pytest
from graph_bag import record


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """Bag of a walk of 5 s in lockstep with seed 3."""
    directory = tmp_path_factory.mktemp("walk")
    return record(directory / "bag", "--lockstep", "--duration", "5", "--seed", "3")
