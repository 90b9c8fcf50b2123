"""Fixtures for tests that start the graph as processes."""

import os

import pytest
from graph_bag import record
from real_graph import PATIENT, changed_config, domain  # noqa: F401 - a fixture


@pytest.fixture(scope="session")
def environment(tmp_path_factory):
    """Environment variables with a configuration of longer time limits."""
    config = changed_config(tmp_path_factory.mktemp("patient"), PATIENT)
    return os.environ | {"SLOT_CONFIG": str(config)}


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """Bag of a walk of 5 s in lockstep with seed 3."""
    directory = tmp_path_factory.mktemp("walk")
    return record(directory / "bag", "--lockstep", "--duration", "5", "--seed", "3")
