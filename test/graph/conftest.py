"""Fixtures for tests that start the graph as processes."""

import os

import pytest
from graph_bag import record
from real_graph import changed_config, domain  # noqa: F401 - a fixture

# Time limits that hold on a busy machine, where processes wait longer than on a robot.
PATIENT = {
    "dynamixel": {"bus.timeout": 0.1, "servo.watchdog": 2.0},
    "supervisor": {
        "timing.command_hold": 1.0,
        "timing.command_lost": 5.0,
        "timing.servo_silent": 2.0,
        "timing.heartbeat": 5.0,
        "timing.estop": 2.0,
        "timing.hold_max": 30.0,
        "timing.torque_change": 5.0,
        "estimate.coast_cycles": 30,
        "estimate.silence": 1.0,
    },
}


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
