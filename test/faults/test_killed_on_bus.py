"""SIGKILL of driver and simulated robot while the robot walks on emulated servos, and commands
stamped by another clock.

Times are those of the messages' stamps.
"""

import copy

import pytest
from real_graph import PATIENT
from rig import BUSY
from sensor_msgs.msg import JointState

from slot_core.safety.states import State
from slot_nodes import qos

# Longer than PATIENT: a driver that starts beside others is delayed more than one that runs.
STARTING = PATIENT | {"dynamixel": {"bus.timeout": 0.2, "servo.watchdog": 2.0}}


@pytest.fixture(scope="module")
def rig(make_rig):
    return make_rig(config=STARTING)


@pytest.fixture
def walking(rig):
    rig.walk_steadily()
    return rig


def test_the_driver_rejects_commands_stamped_by_another_clock(walking):
    """Commands do not pass through the supervisor: the driver checks the stamps itself."""
    foreign = copy.deepcopy(walking.last("/desired_joint_angles"))
    foreign.header.stamp.sec -= 100
    foreign.position = [0.0] * 4
    out = walking.node.create_publisher(JointState, "/desired_joint_angles", qos.CONTROL)
    line = "desired_joint_angles refused: stamped -1"

    def refused():
        out.publish(foreign)
        return line in walking.log("dynamixel_driver")

    walking.wait_for(refused)
    walking.node.destroy_publisher(out)


def time_to_relax(rig, begin):
    """Wait for the RELAX because of silent servos, then FAULT; returns the seconds to RELAX."""
    since, reason = rig.wait_for_state(State.RELAX, begin)
    assert reason.startswith("servo FL silent for ")
    rig.wait_for_state(State.FAULT, since)
    return (since - begin) * 1e-9


def test_a_killed_driver_ends_in_relax_and_the_robot_walks_again_with_a_new_one(walking):
    begin = walking.kill("dynamixel_driver")
    assert time_to_relax(walking, begin) < walking.limit("servo_silent") + BUSY
    walking.start("dynamixel_driver")
    walking.walk_steadily()


def test_a_killed_robot_ends_its_driver_in_one_line_and_both_start_again(walking):
    before = len(walking.log("dynamixel_driver"))
    begin = walking.kill("sim_robot")
    assert walking.exit_code("dynamixel_driver") == 1
    log = walking.log("dynamixel_driver")[before:]
    assert "their bus watchdogs stop the servos" in log
    assert "Traceback" not in log
    assert time_to_relax(walking, begin) < walking.limit("servo_silent") + BUSY
    walking.start("sim_robot", "dynamixel_driver")
    walking.walk_steadily()
