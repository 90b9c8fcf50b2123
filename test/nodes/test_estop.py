"""The topic of the e-stop switches torque off, until it is released and the operator resets."""

import pytest
from std_msgs.msg import Bool

from slot_core.safety.states import State
from slot_msgs.msg import RobotState
from slot_nodes import qos

PERIOD = 0.1  # s, between two messages of the e-stop
STEP = 0.021  # s, between two steps of the supervisor, with the latency of a message


@pytest.fixture(scope="module")
def rig(simulate):
    return simulate()


def test_a_pressed_estop_switches_torque_off_until_it_is_released_and_reset(walking):
    out, estop = walking.publisher(Bool, "estop", qos.SENSOR), Bool(data=True)
    begin = walking.now()
    out.publish(estop)
    walking.every(PERIOD, lambda: out.publish(estop))
    stopped, reason = walking.wait_for_state(State.ESTOP, begin)
    assert (stopped - begin) * 1e-9 < STEP
    assert reason == "e-stop pressed"
    assert walking.last("/robot_state").action == RobotState.ACTION_OFF
    assert walking.request("reset") == "RESET refused in ESTOP: e-stop pressed"
    estop.data = False
    walking.run(2 * PERIOD)  # the supervisor has received it
    assert walking.state is State.ESTOP
    assert walking.request("ready") == "READY changes nothing in ESTOP"
    assert walking.request("reset") == ""
    walking.wait_for(lambda: walking.state is State.IDLE)
    walking.wait_for(lambda: max(walking.last("/joint_states").position) < 0.05)  # slack
