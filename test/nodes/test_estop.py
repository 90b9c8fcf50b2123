"""The topic of the e-stop: sources that press, release and leave, and one of another type."""

import pytest
from std_msgs.msg import Bool

from slot_bringup.monitor import listener
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_msgs.msg import EmergencyStop
from slot_msgs.srv import ForgetSource
from slot_nodes import qos


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


def test_a_source_that_leaves_is_not_missed(walking):
    estop = walking.publisher(EmergencyStop, "estop", qos.SENSOR)
    walking.wait_for(estop.get_subscription_count)
    for leaving in (False, True):
        estop.publish(EmergencyStop(source="terminal", leaving=leaving))
    walking.run(2 * read_supervisor().timing.estop)
    assert walking.state is State.WALKING
    walking.node.destroy_publisher(estop)


def test_a_publisher_of_another_type_counts_as_pressed(walking):
    begin = walking.now()
    with listener("foreign") as (node, _):
        node.create_publisher(Bool, "estop", qos.SENSOR)
        _, reason = walking.wait_for_state(State.ESTOP, begin)
    name = "a publisher of std_msgs/msg/Bool"
    assert reason == f"e-stop pressed at {name}"
    walking.wait_for(lambda: not walking.node.count_publishers("estop"))
    walking.run(1.0)
    assert "RESET refused" in walking.request("reset")
    forget = "/supervisor/forget"
    assert not walking.call(ForgetSource, forget, source="terminal").success
    assert walking.call(ForgetSource, forget, source=name).success
    assert walking.request("reset") == ""
