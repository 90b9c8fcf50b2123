"""The nodes in lockstep, with messages that take time: equal to the core on one clock."""

import pytest

from slot_core.messages import decode
from slot_core.safety.states import State
from slot_core.simulation.supervised_loop import SupervisedLoop
from slot_msgs.msg import EmergencyStop
from slot_nodes import qos

SECONDS = 2.0
SEED = 3


@pytest.fixture
def rig(simulate):
    made = simulate(lockstep=True, seed=SEED)
    yield made
    made.close()


def test_states_equal_those_of_the_core_to_the_last_bit(rig):
    """Commands too: test/graph compares them with those of the processes."""
    rig.wait_for(lambda: rig.messages["/robot_state"])
    states = rig.messages["/robot_state"]
    rig.wait_for(lambda: decode.stamp(states[-1]) * 1e-9 > 1.0 + SECONDS)
    loop = SupervisedLoop("flat", "walk", None, SEED)
    reports = [(loop.plant.now, report) for report in loop.run(SECONDS)]
    states = {decode.stamp(m): m for m in states}
    # /robot_state keeps one message: while DDS matches the listener, it may miss one of the first
    received = [item for item in reports if item[0] in states]
    assert len(received) > max(100, len(reports) - 3)
    for stamp, report in received:
        assert states[stamp].state == report.state
        assert states[stamp].reason == report.reason
        assert list(states[stamp].slack) == pytest.approx(
            report.slack, abs=0.0, nan_ok=True
        )


def test_an_estop_is_released_by_the_source_that_has_pressed_it_alone(rig):
    """None is missed: they send in real time, which has no meaning on the robot's clock."""
    estop = rig.publisher(EmergencyStop, "estop", qos.SENSOR)

    def send(source, pressed):
        estop.publish(EmergencyStop(source=source, pressed=pressed))
        rig.run(0.01)

    send("terminal", pressed=False)
    rig.wait_for(lambda: rig.state is State.WALKING)
    send("button", pressed=True)
    send("terminal", pressed=False)
    rig.wait_for(lambda: rig.state is State.ESTOP)
    assert "e-stop pressed at button" in rig.request("reset")
    send("button", pressed=False)
    assert rig.request("reset") == ""
    assert rig.wait_for(lambda: rig.state is State.IDLE)
