"""Fixtures for tests that start the graph as processes."""

import os
import shutil
from pathlib import Path

import pytest
from graph_bag import record

DOMAINS = 100  # beyond, the ports of DDS run into those that the system hands out
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


@pytest.fixture(scope="session", autouse=True)
def domain():
    """A ROS domain for every process that runs tests: their graphs do not hear each other."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(1 + os.getpid() % DOMAINS))
        yield


@pytest.fixture(scope="session")
def environment(tmp_path_factory):
    """Environment with a configuration of longer time limits."""
    config = tmp_path_factory.mktemp("patient") / "config"
    shutil.copytree(Path(__file__).parents[2] / "config", config)
    for name, changes in PATIENT.items():
        text = (config / name).read_text()
        for before, after in changes.items():
            assert text.count(before) == 1, before
            text = text.replace(before, after)
        (config / name).write_text(text)
    return os.environ | {"SLOT_CONFIG": str(config)}


@pytest.fixture(scope="session")
def walk(tmp_path_factory):
    """Bag of a walk of 5 s in lockstep with seed 3."""
    directory = tmp_path_factory.mktemp("walk")
    return record(directory / "bag", "--lockstep", "--duration", "5", "--seed", "3")
