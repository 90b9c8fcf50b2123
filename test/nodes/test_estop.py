"""The topic of the e-stop: what it switches off, and that it may be required."""

import pytest
from std_msgs.msg import Bool

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


def test_a_pressed_estop_switches_torque_off_until_it_is_released_and_reset(walking):
    begin = walking.estop.press(True)
    stopped, reason = walking.wait_for_state(State.ESTOP, begin)
    assert (stopped - begin) * 1e-9 < STEP
    assert reason == "e-stop pressed"
    assert walking.last("/robot_state").action == RobotState.ACTION_OFF
    assert walking.request("reset") == "RESET refused in ESTOP: e-stop pressed"
    walking.estop.press(False)
    walking.run(2 * PERIOD)  # the supervisor has received it
    assert walking.state is State.ESTOP
    assert walking.request("ready") == "READY changes nothing in ESTOP"
    assert walking.request("reset") == ""
    walking.wait_for(lambda: walking.state is State.IDLE)
    walking.wait_for(lambda: max(walking.last("/joint_states").position) < 0.05)  # slack


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
