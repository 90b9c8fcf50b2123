"""Invalid messages on the topics of a walking graph are refused, and the robot walks on."""

import copy
import math

import pytest
from geometry_msgs.msg import PoseStamped, Vector3
from sensor_msgs.msg import Imu

from slot_core.robot import TENDON_JOINTS, read_robot
from slot_core.safety.states import State
from slot_msgs.msg import GaitPreview, MpcState, TendonPlan
from slot_msgs.srv import SetGait
from slot_nodes import qos

TOPICS = {
    "/imu": (Imu, qos.SENSOR),
    "/mpc_state": (MpcState, qos.CONTROL),
    "/gait_preview": (GaitPreview, qos.CONTROL),
    "/tendon_plan": (TendonPlan, qos.CONTROL),
}
NAN, INF = math.nan, math.inf
SAID = {  # by the node that refuses a message of the topic
    "/tendon_plan": (
        "force_mapper",
        "tendon_plan refused: angle[0, 0] = nan: expected a finite number",
    ),
    "/mpc_state": (
        "gait_scheduler",
        "mpc_state refused: state[3] = nan: expected a finite number",
    ),
    "/desired_joint_angles": (
        "sim_robot",
        "desired_joint_angles refused: joints ['a', 'b', 'c', 'd']: expected ",
    ),
}
TICKS = 8  # of the controller: a quarter of a second
ANGLE_MAX = read_robot().tendon.angle_max


@pytest.fixture(scope="module")
def rig(simulate):
    made = simulate()
    for topic, (kind, profile) in TOPICS.items():
        made.subscribe(topic, kind, profile)
    return made


def last(rig, topic):
    """Newest message of the node that publishes a topic."""
    received = reversed(rig.messages[topic])
    return next(m for m in received if m.header.frame_id != "intruder")


def send(rig, topic, values):
    """Publish a copy of the last message of a topic with other values."""
    message = copy.deepcopy(last(rig, topic))
    message.header.frame_id = "intruder"
    for name, value in values.items():
        *parents, attribute = name.split(".")
        part = message
        for parent in parents:
            part = getattr(part, parent)
        setattr(part, attribute, value)
    # as its node: a second publisher of a command stops the robot
    rig.publisher_of(topic).publish(message)


def assert_walks_on(rig):
    """TICKS commands follow, in their range."""
    begin = rig.now()
    rig.wait_for(
        lambda: len(rig.since("/desired_joint_angles", begin)) >= TICKS
    )
    assert rig.exit_codes == {}
    assert rig.state in {State.WALKING, State.HOLD}
    for message in rig.messages["/desired_joint_angles"]:
        if message.header.frame_id != "intruder":
            assert tuple(message.name) == TENDON_JOINTS
            assert all(0.0 <= angle <= ANGLE_MAX for angle in message.position)


@pytest.mark.parametrize(
    ("topic", "values"),
    [
        ("/desired_joint_angles", {"name": ["a", "b", "c", "d"]}),
        ("/desired_joint_angles", {"position": [1.0] * 3}),
        ("/desired_joint_angles", {"velocity": [1.0] * 3}),
        ("/tendon_plan", {"angle": [NAN] * 88}),
        ("/tendon_plan", {"rate": [INF] * 4}),
        ("/tendon_plan", {"force": []}),
        ("/tendon_plan", {"angle": [1.0] * 7}),
        ("/gait_preview", {"stages": 0}),
        ("/gait_preview", {"stages": 7}),
        # no array of that size is made
        (
            "/gait_preview",
            {"stages": 2**32 - 1},
        ),
        ("/gait_preview", {"dt": 0.0}),
        ("/gait_preview", {"tendon_angle": []}),
        ("/gait_preview", {"tendon_angle": [1.0] * 16}),
        ("/gait_preview", {"tendon_angle": [NAN] * 96}),
        ("/mpc_state", {"position.x": NAN}),
        ("/mpc_state", {"rpy.x": INF, "position.z": 1e308}),
        ("/odom", {"pose.pose.position.x": NAN}),
        ("/odom", {"pose.pose.orientation.w": 0.0}),
        ("/imu", {"angular_velocity.x": NAN}),
    ],
)
def test_invalid_messages_with_present_stamps_are_refused_and_the_robot_walks_on(
    walking, topic, values
):
    """One after each of three messages; the first of a topic is said with value and limit."""
    for _ in range(3):
        before = last(walking, topic)
        walking.wait_for(
            lambda before=before: last(walking, topic) is not before
        )
        send(walking, topic, values)
    assert_walks_on(walking)
    name, line = SAID.get(topic, ("sim_robot", ""))
    assert line in walking.log(name)


def test_a_body_pose_is_followed_unless_it_is_invalid_or_out_of_range(walking):
    poses = walking.publisher(PoseStamped, "body_pose", qos.SENSOR)

    def command(height, w=1.0):
        pose = PoseStamped()
        pose.pose.position.z, pose.pose.orientation.w = height, w
        poses.publish(pose)

    request = {"gait": "walk", "velocity": Vector3(x=0.05)}
    assert walking.call(SetGait, "/set_gait", **request).success
    command(0.065)
    walking.wait_for(lambda: last(walking, "/gait_preview").pose[0] == 0.065)
    for height, w in (
        (NAN, 1.0),
        (INF, 1.0),
        (0.5, 1.0),
        (0.06, 0.0),
        (0.06, NAN),
    ):
        command(height, w)
    assert_walks_on(walking)
    assert last(walking, "/gait_preview").pose[0] == 0.065
    assert "body_pose refused: " in walking.log("gait_scheduler")
