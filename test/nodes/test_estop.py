"""The topic of the e-stop switches torque off, until it is released and the operator resets."""

import pytest
from std_msgs.msg import Bool

from slot_bringup.monitor import listener
from slot_core.safety.states import State
from slot_msgs.msg import EmergencyStop, RobotState
from slot_msgs.srv import ForgetSource
from slot_nodes import qos

PERIOD = 0.1  # s, between two messages of a source
STEP = 0.021  # s, between two steps of the supervisor, with the latency of a message


class Source:
    def __init__(self, rig, name):
        self.out = rig.publisher(EmergencyStop, "estop", qos.SENSOR)
        self._message = EmergencyStop(source=name)
        self.timer = rig.every(PERIOD, lambda: self.out.publish(self._message))

    def send(self, **fields):
        """Send a state, and repeat it."""
        self._message = EmergencyStop(source=self._message.source, **fields)
        self.out.publish(self._message)


def test_in_lockstep_an_estop_is_released_by_the_source_that_has_pressed_it_alone(
    simulate,
):
    """None is missed: they send in real time, which has no meaning on the robot's clock."""
    rig = simulate(lockstep=True)
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
    rig.close()


@pytest.fixture(scope="module")
def rig(simulate):
    return simulate()


@pytest.fixture
def sources(walking):
    """A button and a terminal, which leave after the test."""
    made = [Source(walking, name) for name in ("button", "terminal")]
    walking.run(2 * PERIOD)
    yield made
    for source in made:
        source.send(leaving=True)
        source.timer.cancel()
        walking.node.destroy_publisher(source.out)
    walking.run(PERIOD)


def test_a_pressed_estop_switches_torque_off_until_it_is_released_and_reset(
    walking, sources
):
    button, _ = sources
    begin = walking.now()
    button.send(pressed=True)
    stopped, reason = walking.wait_for_state(State.ESTOP, begin)
    assert (stopped - begin) * 1e-9 < STEP
    assert reason == "e-stop pressed at button"
    assert walking.last("/robot_state").action == RobotState.ACTION_OFF
    assert "RESET refused" in walking.request("reset")
    button.send(pressed=False)
    walking.run(2 * PERIOD)  # the supervisor has received it
    assert walking.state is State.ESTOP
    assert walking.request("reset") == ""
    walking.wait_for(lambda: walking.state is State.IDLE)
    # slack
    walking.wait_for(lambda: max(walking.last("/joint_states").position) < 0.05)


def test_a_publisher_of_another_type_counts_as_pressed(walking, sources):
    begin = walking.now()
    with listener("foreign") as (node, _):
        node.create_publisher(Bool, "estop", qos.SENSOR)
        _, reason = walking.wait_for_state(State.ESTOP, begin)
    name = "a publisher of std_msgs/msg/Bool"
    assert reason == f"e-stop pressed at {name}"
    walking.wait_for(
        lambda: walking.node.count_publishers("estop") == len(sources)
    )
    walking.run(1.0)
    assert "RESET refused" in walking.request("reset")
    forget = "/supervisor/forget"
    assert not walking.call(ForgetSource, forget, source="terminal").success
    assert walking.call(ForgetSource, forget, source=name).success
    assert walking.request("reset") == ""
