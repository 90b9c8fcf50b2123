"""Driver and simulated robot are killed with SIGKILL while the robot walks on emulated servos; and
commands of another clock on the way to them.

Times are those of the messages' stamps. BUSY is what a busy machine may add to a limit.
"""

import copy

import pytest
from rig import PATIENT
from sensor_msgs.msg import JointState

from slot_core.safety.states import State
from slot_nodes import qos

BUSY = 0.3  # s
# A driver that starts beside others is kept waiting for longer than one that runs.
STARTING = PATIENT | {
    "dynamixel.yaml": {"  timeout: 0.008": "  timeout: 0.2", "  watchdog: 0.1": "  watchdog: 2.0"},
}


@pytest.fixture(scope="module")
def rig(make_rig):
    return make_rig(config=STARTING)


@pytest.fixture
def walking(rig):
    rig.walk_on()
    return rig


def test_the_driver_refuses_commands_of_another_clock(walking):
    """The wire goes past the supervisor: it looks itself."""
    foreign = copy.deepcopy(walking.last("/desired_joint_angles"))
    foreign.header.stamp.sec -= 100
    foreign.position = [0.0] * 4
    out = walking.node.create_publisher(JointState, "/desired_joint_angles", qos.CONTROL)
    told = "desired_joint_angles refused: stamped -1"

    def refused():
        out.publish(foreign)
        return told in walking.log("dynamixel_driver")

    walking.wait_for(refused)
    walking.node.destroy_publisher(out)


def relaxed(rig, begin):
    """Seconds to RELAX, which silent servos cause; then to FAULT, until somebody asks."""
    since, reason = rig.reached(State.RELAX, begin)
    assert reason.startswith("servo FL silent for ")
    rig.reached(State.FAULT, since)
    return (since - begin) * 1e-9


def test_without_its_driver_the_robot_relaxes_and_walks_again_with_it(walking):
    begin = walking.kill("dynamixel_driver")
    assert relaxed(walking, begin) < walking.limit("servo_silent") + BUSY
    walking.start("dynamixel_driver")
    walking.walk_on()


def test_without_the_robot_its_driver_ends_in_one_line_and_both_walk_again(walking):
    before = len(walking.log("dynamixel_driver"))
    begin = walking.kill("sim_robot")
    assert walking.exit_code("dynamixel_driver") == 1
    told = walking.log("dynamixel_driver")[before:]
    assert "their bus watchdogs stop the servos" in told
    assert "Traceback" not in told
    assert relaxed(walking, begin) < walking.limit("servo_silent") + BUSY
    walking.start("sim_robot", "dynamixel_driver")
    walking.walk_on()
