"""A second publisher of what the servos obey lets them relax, and cannot bring torque on."""

import copy

import pytest
from sensor_msgs.msg import JointState

from slot_core.messages import decode
from slot_core.safety.states import Action
from slot_msgs.msg import RobotState, ServoLimits, TendonPlan
from slot_nodes import qos

TOPICS = {
    "robot_state": (RobotState, qos.STATE, "supervisor"),
    "servo_limits": (ServoLimits, qos.STATE, "supervisor"),
    "desired_joint_angles": (JointState, qos.CONTROL, "force_mapper"),
}
FORGED = 0.02  # s, between two forged messages
LATEST = 0.05  # s, from a cause to its first report


@pytest.fixture(scope="module", params=["sim", "fake_bus"])
def rig(request, simulate):
    made = simulate(hardware=request.param)
    made.subscribe("/servo_limits", ServoLimits, qos.STATE)
    yield made
    made.close()


@pytest.fixture
def intruder(walking):
    """Publishes a message on a topic, again and again, until the end of the test."""
    made = []

    def publish(topic, message):
        kind, profile, _ = TOPICS[topic]
        out, message = (
            walking.publisher(kind, topic, profile),
            copy.deepcopy(message),
        )
        made.append(
            (
                out,
                walking.every(
                    FORGED, lambda: out.publish(present(walking, message))
                ),
            )
        )

    yield publish
    for out, timer in made:
        timer.cancel()
        walking.node.destroy_publisher(out)
    walking.run(0.1)


def present(rig, message):
    """The message with the present stamp, if it has one."""
    if hasattr(message, "header"):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(
            rig.now(), 10**9
        )
    return message


def first_relax(rig, begin):
    """First report of the servos in RELAX since a time; forged states hide the true ones."""
    relaxes = decode.ACTION_NUMBERS.index(Action.RELAX)
    return rig.wait_for(
        lambda: next(
            (
                m
                for m in rig.since("/servo_health", begin)
                if m.action == relaxes
            ),
            None,
        )
    )


@pytest.mark.parametrize("topic", TOPICS)
def test_a_second_publisher_lets_the_robot_relax_by_name_and_stand_up_no_more(
    walking, intruder, topic
):
    begin = walking.now()
    intruder(topic, walking.last(f"/{topic}"))
    report = first_relax(walking, begin)
    line = f"/{topic} has 2 publishers, limit 1: /{TOPICS[topic][2]}, /tester"
    assert report.reason == line
    assert (decode.stamp(report) - begin) * 1e-9 < LATEST
    walking.wait_for_torque_off(begin)
    walking.run(0.1)
    fault = f"FAULT: slack after: servos: {line}"
    assert fault in walking.logs["supervisor"]
    walking.wait_for(lambda: not walking.request("reset"))
    walking.run(0.5)
    begin = walking.now()
    walking.request("ready")
    walking.run(1.0)
    assert not any(walking.since("/servo_health", begin)[-1].torque)


# the supervisor sees it, whatever the servos are
@pytest.mark.parametrize("rig", ["sim"], indirect=True)
def test_two_controllers_let_a_walking_robot_relax_and_are_named(walking):
    begin = walking.now()
    second = walking.publisher(TendonPlan, "tendon_plan", qos.CONTROL)
    walking.wait_for_torque_off(begin)
    walking.node.destroy_publisher(second)
    line = "/tendon_plan has 2 publishers, limit 1: /mpc_controller, /tester"
    assert f"RELAX: {line}" in walking.logs["supervisor"]


def test_a_forged_permission_brings_no_torque_in_estop(walking, intruder):
    forged = walking.last("/robot_state")
    walking.request("estop")
    walking.wait_for_torque_off(walking.now())
    begin = walking.now()
    intruder("robot_state", forged)
    walking.run(1.0)
    reports = walking.since("/servo_health", begin)
    assert len(reports) > 10
    assert not any(any(report.torque) for report in reports)


def test_an_estop_switches_torque_off_beside_a_second_publisher(
    walking, intruder
):
    begin = walking.now()
    intruder("robot_state", walking.last("/robot_state"))
    first_relax(walking, begin)
    pressed = walking.now()
    walking.request("estop")
    off = walking.wait_for_torque_off(pressed)
    assert (decode.stamp(off) - pressed) * 1e-9 < LATEST
