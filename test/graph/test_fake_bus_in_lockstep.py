"""The graph on emulated servos in lockstep: driver and bus on the robot's clock.

In one process; test_walk.py compares separate ones with it.
"""

import numpy as np
import pytest
from graph_bag import commands_of_core, read, recorded_commands
from recorded_run import record

from slot_bringup.monitor import RunError
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import RAD_PER_COUNT

OPTIONS = ("--lockstep", "--composed", "--hardware", "fake_bus", "--seed", "3")
UNPLUGGED = """
like: flat
faults:
  all: {kind: unplugged, leg: all, time: 0.5, duration: 0.0, value: 0.0}
"""


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """Bag of a walk of 2 s."""
    return record(
        tmp_path_factory.mktemp("walk") / "bag", *OPTIONS, "--duration", "2"
    )


def test_graph_gives_the_commands_of_the_core_in_one_process(walk):
    """Bit-equal."""
    recorded = recorded_commands(walk)
    commands = commands_of_core(3, 2.5, "fake_bus")
    assert len(commands) > 70
    shared = recorded.keys() & commands.keys()
    assert len(shared) > 60
    for stamp in shared:
        assert np.array_equal(recorded[stamp], commands[stamp]), stamp
    assert any(np.ptp(recorded[stamp][0]) > 0.1 for stamp in shared)  # it walks


def test_joint_states_are_those_of_the_encoders_every_bus_cycle(walk):
    rows = read(walk)["/joint_states"]
    assert len(rows) > 200
    joints = read_settings().joints
    for _, message in rows:
        angle = (
            np.array(message.position)
            * joints.servo_per_tendon
            * np.sign(joints.direction)
        )
        counts = (angle + np.radians(joints.zero_deg)) / RAD_PER_COUNT
        assert counts == pytest.approx(np.round(counts), abs=1e-6)


def test_run_ends_with_torque_off(walk):
    assert (
        "servos left under torque: none"
        in (walk / "log/controller.log").read_text()
    )


def test_an_unplugged_bus_ends_the_run_as_its_driver_would(
    tmp_path, own_config
):
    (own_config / "scene" / "unplugged.yaml").write_text(UNPLUGGED)
    with pytest.raises(RunError, match="controller ended"):
        record(
            tmp_path / "bag",
            *OPTIONS,
            "--scene",
            "unplugged",
            "--duration",
            "5",
        )
    log = (tmp_path / "bag/log/controller.log").read_text()
    assert "their bus watchdogs stop the servos" in log
    assert "Traceback" not in log
