"""ROS domain and configuration of tests that start nodes as processes."""

import contextlib
import functools
import os
import shutil
import socket
from pathlib import Path

import pytest
import yaml

from slot_bringup.graph import read_graph

DOMAINS = 100  # above 101 the ports of DDS lie in the range that Linux assigns dynamically
SLOW_MPC = {"acceptance.time_budget": 0.2}  # s, on a busy machine
# Time limits that hold on a busy machine, where processes wait longer than on a robot. Without
# `clock_jump` a supervisor that has waited for 0.5 s reports a jump of the clock and holds.
PATIENT = {
    "dynamixel": {"bus.timeout": 0.1, "servo.watchdog": 2.0},
    "supervisor": {
        "timing.command_hold": 0.5,
        "timing.command_lost": 3.0,
        "timing.clock_jump": 60.0,
        "timing.heartbeat": 4.0,
        "timing.estop": 2.0,
        "timing.servo_silent": 2.0,
        "timing.torque_change": 4.0,
        "timing.hold_max": 30.0,
        "timing.holds_max": 1000,
        "estimate.coast_cycles": 30,
        "estimate.silence": 1.0,
    },
    "mpc": SLOW_MPC,
}


_claims = []


def claim_domain():
    """A ROS domain, 1 .. DOMAINS, that no other test process of this machine has claimed.

    The claim is a socket of Linux's abstract namespace; it ends with this process.
    """
    for number in range(os.getpid(), os.getpid() + DOMAINS):
        domain = str(1 + number % DOMAINS)
        _claims.append(socket.socket(socket.AF_UNIX))
        with contextlib.suppress(OSError):  # has been claimed
            _claims[-1].bind(f"\0slot_test_domain_{domain}")
            return domain
    raise RuntimeError(f"all {DOMAINS} ROS domains of the tests are claimed")


@pytest.fixture(scope="session", autouse=True)
def domain():
    """Separate ROS domain for every test process, so that graphs do not communicate."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", claim_domain())
        yield


def nodes_of(**changes):
    """Nodes of the graph by name, with changed values of its arguments."""
    graph = read_graph()
    values = {a.name: a.default for a in graph.arguments} | changes
    return {spec.name: spec for spec in graph.nodes(values)}


def changed_config(directory, changes):
    """Copy config/ below `directory` and set values in the copy, see `set_values`; its path."""
    config = directory / "config"
    shutil.copytree(Path(__file__).parents[1] / "config", config)
    set_values(config, changes)
    return config


def set_values(config, changes):
    """Set values in a copy of config/: {file: {dotted name: value}}; every name has to be there."""
    for file, values in changes.items():
        path = config / f"{file}.yaml"
        content = yaml.safe_load(path.read_text())
        for name, value in values.items():
            *parents, last = name.split(".")
            mapping = functools.reduce(dict.__getitem__, parents, content)
            assert last in mapping, f"{file}.yaml: {name} is not a setting"
            mapping[last] = value
        # one line per list, as `write_zero` expects
        path.write_text(
            yaml.safe_dump(content, default_flow_style=None, width=1000)
        )
