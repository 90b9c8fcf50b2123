"""The start of the graph in any order: requests are not lost, and a frozen robot obeys."""

import pytest
from nav_msgs.msg import Odometry
from rclpy.client import Client
from sensor_msgs.msg import Imu

from slot_core.messages import decode
from slot_core.safety.states import State
from slot_msgs.msg import GaitPreview
from slot_nodes import messages, qos
from slot_nodes.sim_robot_node import SimRobotNode
from slot_nodes.supervisor_node import SupervisorNode


@pytest.fixture
def rig(simulate):
    made = simulate()
    made.subscribe("/gait_preview", GaitPreview, qos.CONTROL)
    yield made
    made.close()


def test_a_gait_is_requested_once_its_service_is_discovered(rig, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(Client, "service_is_ready", lambda _: False)
        rig.wait_for(lambda: rig.state is State.WALKING)
        rig.run(0.3)
        assert rig.last("/gait_preview").gait == "stand"
    rig.run(0.3)
    assert rig.last("/gait_preview").gait == "walk"


def test_a_subscriber_that_is_never_matched_does_not_keep_the_robot_from_starting(
    rig, monkeypatch
):
    """One that asks for another quality of service, for example."""
    monkeypatch.setattr(
        SimRobotNode, "get_subscriptions_info_by_topic", lambda *_: [None] * 9
    )
    begin = rig.now()
    rig.wait_for(lambda: rig.messages["/odom"])
    assert 5.0 < (rig.now() - begin) * 1e-9 < 6.0
    rig.wait_for(lambda: rig.state is State.WALKING)


def test_limits_that_were_lost_come_again(simulate, monkeypatch):
    sent, send = [], SupervisorNode._send_limits

    def send_but_the_first(node):
        sent.append(node)
        if len(sent) > 1:
            send(node)

    monkeypatch.setattr(SupervisorNode, "_send_limits", send_but_the_first)
    rig = simulate()
    rig.wait_for(lambda: rig.state is State.WALKING)
    rig.close()


def test_a_robot_that_is_still_frozen_obeys_off(rig):
    """Its first command has not arrived when the e-stop is pressed: the tendons unwind."""
    while rig.state is not State.STANDING:
        rig.run(0.0002)
    assert rig.nodes["sim_robot"]._frozen
    assert rig.request("estop") == ""
    rig.run(1.5)
    assert rig.state is State.ESTOP
    assert not any(rig.last("/servo_health").torque)
    assert max(rig.last("/joint_states").position) < 0.05


def test_filtered_odometry_comes_with_every_imu_sample_once_somebody_listens(
    rig, monkeypatch
):
    made = []
    convert = messages.estimate_to_odometry
    monkeypatch.setattr(
        messages, "estimate_to_odometry", lambda e: made.append(e) or convert(e)
    )
    rig.wait_for(lambda: rig.state is State.STANDING)
    assert made == []  # it would cost more than the filter
    rig.subscribe("/imu", Imu, qos.SENSOR)
    rig.subscribe("/odometry/filtered", Odometry, qos.SENSOR)
    rig.wait_for(lambda: rig.messages["/odometry/filtered"])
    rig.run(0.5)
    samples, filtered = (
        [decode.stamp(message) for message in rig.messages[topic]]
        for topic in ("/imu", "/odometry/filtered")
    )
    assert len(filtered) > 90
    begin = samples.index(filtered[0])
    assert filtered == samples[begin : begin + len(filtered)]
