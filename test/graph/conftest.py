"""Fixtures for tests that start the graph as processes."""

import os

import pytest
from graph_bag import record
from real_graph import changed_config, domain  # noqa: F401 - a fixture

# A busy machine keeps processes waiting for longer than a robot may: time limits that it keeps.
PATIENT = {
    "dynamixel.yaml": {"  timeout: 0.008": "  timeout: 0.1", "  watchdog: 0.1": "  watchdog: 2.0"},
    "supervisor.yaml": {
        "command_hold: 0.1": "command_hold: 1.0", "command_lost: 0.5": "command_lost: 5.0",
        "servo_silent: 0.5": "servo_silent: 2.0", "heartbeat: 0.5": "heartbeat: 5.0",
        "  estop: 0.5": "  estop: 2.0", "coast_cycles: 3": "coast_cycles: 30",
        "hold_max: 5.0": "hold_max: 30.0", "obey: 1.0": "obey: 5.0",
    },
}  # fmt: skip


@pytest.fixture(scope="session")
def environment(tmp_path_factory):
    """Environment with a configuration of longer time limits."""
    config = changed_config(tmp_path_factory.mktemp("patient"), PATIENT)
    return os.environ | {"SLOT_CONFIG": str(config)}


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """Bag of a walk of 5 s in lockstep with seed 3."""
    directory = tmp_path_factory.mktemp("walk")
    return record(directory / "bag", "--lockstep", "--duration", "5", "--seed", "3")
