"""E-stop, loss of its source, and tilt of the torso end in torque off."""

import pytest
from rig import TICK
from scipy.spatial.transform import Rotation
from std_msgs.msg import Bool

from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_msgs.msg import RobotState
from slot_nodes import qos

PERIOD = 0.1  # s, between two messages of the e-stop
STEP = 0.021  # s, between two steps of the supervisor, with the latency of a message


class EStop:
    """An e-stop that repeats whether it is pressed, unless its cable is cut."""

    def __init__(self, rig):
        self.rig, self.pressed, self.cut = rig, False, False
        self._out = rig.publisher(Bool, "estop", qos.SENSOR)
        rig.every(PERIOD, self.publish)

    def publish(self):
        if not self.cut:
            self._out.publish(Bool(data=self.pressed))

    def press(self, pressed):
        """Press or release it; returns the time before."""
        begin = self.rig.now()
        self.pressed = pressed
        self.publish()
        return begin


@pytest.fixture(scope="module")
def rig(simulate):
    made = simulate()
    made.estop = EStop(made)
    return made


@pytest.fixture
def walking(rig):
    rig.walk_steadily()
    return rig


def wait_two_periods(rig):
    """Wait until the supervisor has received the e-stop's state."""
    rig.run(2 * PERIOD)


def test_a_pressed_estop_switches_torque_off_until_it_is_released_and_reset(walking):
    begin = walking.estop.press(True)
    stopped, reason = walking.wait_for_state(State.ESTOP, begin)
    assert (stopped - begin) * 1e-9 < STEP
    assert reason == "e-stop pressed"
    assert walking.last("/robot_state").action == RobotState.ACTION_OFF
    assert walking.request("reset") == "RESET refused in ESTOP: e-stop pressed"
    walking.estop.press(False)
    wait_two_periods(walking)
    assert walking.state is State.ESTOP
    assert walking.request("ready") == "READY changes nothing in ESTOP"
    assert walking.request("reset") == ""
    walking.wait_for(lambda: walking.state is State.IDLE)
    walking.wait_for(lambda: max(walking.last("/joint_states").position) < 0.05)  # slack


def test_a_lost_estop_source_switches_torque_off_until_it_returns_and_a_reset(walking):
    begin = walking.now()
    walking.estop.cut = True
    stopped, reason = walking.wait_for_state(State.ESTOP, begin)
    assert (stopped - begin) * 1e-9 < walking.limit("estop") + STEP
    assert reason.startswith("e-stop source silent for ")
    assert reason.endswith(" s, limit 0.5 s")
    assert "e-stop source silent" in walking.request("reset")
    walking.estop.cut = False
    wait_two_periods(walking)
    assert walking.state is State.ESTOP
    assert walking.request("reset") == ""


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_tilt_beyond_half_a_radian_ends_in_fault_until_the_torso_is_upright(walking, axis):
    """The estimator rejects the jump of the odometry first, and accepts it once it lasts."""

    def tilt(message):
        orientation = message.pose.pose.orientation
        before = Rotation.from_quat([orientation.x, orientation.y, orientation.z, orientation.w])
        after = before * Rotation.from_euler(axis, 0.75)
        x, y, z, w = (float(part) for part in after.as_quat())
        orientation.x, orientation.y, orientation.z, orientation.w = x, y, z, w

    name = {"x": "roll", "y": "pitch"}[axis]
    with walking.changed("odom", tilt) as begin:
        relaxed, reason = walking.wait_for_state(State.RELAX, begin)
        assert (relaxed - begin) * 1e-9 < 7 * TICK + STEP
        assert reason.startswith(f"{name} +0.")
        assert reason.endswith(f" rad, limit {read_supervisor().estimate.tilt_max:g} rad")
        walking.wait_for_state(State.FAULT, relaxed)
        assert walking.request("reset") == ""
        assert walking.request("ready").startswith(f"READY refused in IDLE: {name} +0.")
    walking.walk()


def test_ready_is_refused_without_a_required_estop_source(walking):
    walking.kill("supervisor")
    walking.estop.cut = True
    walking.start("supervisor", parameters={"estop_required": True})
    walking.wait_for(lambda: walking.state is State.IDLE)
    refusal = "READY refused in IDLE: e-stop source silent since the start, limit 0.5 s"
    walking.wait_for(lambda: walking.request("ready") == refusal)
    assert walking.state is State.IDLE
    walking.estop.cut = False
    walking.walk()
