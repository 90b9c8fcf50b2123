"""The graph on emulated servos: the real driver at a pseudo-terminal.

Real time: the serial line, and processes from start to end.
"""

import subprocess
import sys

import numpy as np
import pytest
from graph_bag import read

from slot_core.dynamics.scene import read_scene
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.robot import TENDON_JOINTS, read_robot

pytestmark = pytest.mark.real_time

RUN = [sys.executable, "-m", "slot_bringup", "--hardware", "fake_bus"]
PERIOD = read_scene("flat").sensors.odometry.period  # s


@pytest.fixture(scope="module")
def walk(environment, tmp_path_factory):
    """Bag of a walk of 5 s on emulated servos."""
    bag = tmp_path_factory.mktemp("fake_bus") / "bag"
    done = subprocess.run(
        [*RUN, "--duration", "5", "--seed", "3", "--bag", str(bag)],
        env=environment, capture_output=True, text=True, timeout=150, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return bag


@pytest.fixture(scope="module")
def messages(walk):
    return read(walk)


def test_robot_walks_with_the_real_driver(messages):
    """Measured: 44 mm/s on average. Half of it shows that the robot walks."""
    truth = [m.pose.pose.position for _, m in messages["/ground_truth/odom"]]
    assert len(truth) > 120
    assert (truth[-1].x - truth[0].x) / (PERIOD * len(truth)) > 0.02


def test_joint_states_come_only_from_the_driver(messages):
    limit = read_robot().tendon.angle_max
    assert len(messages["/joint_states"]) > 200
    for _, message in messages["/joint_states"]:
        assert tuple(message.name) == TENDON_JOINTS
        assert np.isfinite([*message.position, *message.velocity, *message.effort]).all()
        assert -0.1 < min(message.position) <= max(message.position) < limit + 0.1
        # angles of an encoder are whole counts
        counts = (np.array(message.position) * 1.03199 + np.radians(130.0)) / RAD_PER_COUNT
        assert counts == pytest.approx(np.round(counts), abs=1e-6)


def test_diagnostics_have_a_status_for_the_bus_and_every_servo(messages):
    _, last = messages["/diagnostics"][-1]
    assert [status.name for status in last.status] == [
        "servo bus", "servo FL (id 5)", "servo FR (id 4)", "servo RL (id 2)", "servo RR (id 3)",
    ]  # fmt: skip
    bus, *servos = ({v.key: v.value for v in status.values} for status in last.status)
    assert bus["action"] == "pass"
    assert float(bus["rate_Hz"]) > 20.0
    for servo in servos:
        assert servo["torque"] == "on"
        assert servo["hardware_errors"] == "none"
        assert float(servo["voltage_V"]) == pytest.approx(11.1, abs=0.05)
        assert 20.0 < float(servo["temperature_C"]) < 40.0


def test_run_ends_with_torque_off_at_driver_and_servos(walk):
    assert "torque off, confirmed by every servo" in (walk / "log/dynamixel_driver.log").read_text()
    assert "servos left under torque: none" in (walk / "log/sim_robot.log").read_text()
