"""Driver and simulated robot are killed while the robot walks on emulated servos, and commands
stamped by another clock.

Times are those of the messages' stamps.
"""

import copy

import pytest

from slot_core.safety.states import State
from slot_nodes import qos

LATE = 0.05  # s, from a limit to the reaction: two steps of the supervisor and a bus cycle


@pytest.fixture(scope="module")
def rig(simulate):
    return simulate(hardware="fake_bus")


@pytest.fixture
def walking(rig):
    rig.walk_steadily()
    return rig


def test_the_driver_rejects_commands_stamped_by_another_clock(walking):
    """Commands do not pass through the supervisor: the driver checks the stamps itself."""
    foreign = copy.deepcopy(walking.last("/desired_joint_angles"))
    foreign.header.stamp.sec -= 100
    foreign.position = [0.0] * 4
    walking.publisher(None, "desired_joint_angles", qos.CONTROL).publish(foreign)
    walking.run(0.01)
    assert "desired_joint_angles refused: stamped -1" in walking.log("dynamixel_driver")


def time_to_relax(rig, begin, reason):
    """Wait for RELAX with that reason, then FAULT; returns the seconds to RELAX."""
    since, found = rig.wait_for_state(State.RELAX, begin)
    assert found.startswith(reason)
    rig.wait_for_state(State.FAULT, since)
    return (since - begin) * 1e-9


def test_a_killed_driver_ends_in_relax_and_the_robot_walks_again_with_a_new_one(walking):
    begin = walking.kill("dynamixel_driver")
    assert (
        time_to_relax(walking, begin, "servo FL silent for ") < walking.limit("servo_silent") + LATE
    )
    walking.start("dynamixel_driver")
    walking.walk_steadily()


def test_a_killed_robot_ends_its_driver_in_one_line_and_both_start_again(walking):
    """Its odometry ends with it, a little before the servos' last answers."""
    before = len(walking.log("dynamixel_driver"))
    begin = walking.kill("sim_robot")
    assert walking.exit_code("dynamixel_driver") == 1
    log = walking.log("dynamixel_driver")[before:]
    assert "their bus watchdogs stop the servos" in log
    assert "Traceback" not in log
    assert time_to_relax(walking, begin, "no command for ") < walking.limit("command_lost") + LATE
    walking.start("sim_robot", "dynamixel_driver")
    walking.walk_steadily()
