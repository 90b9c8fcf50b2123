"""Invalid messages on the topics of a walking graph are refused, and the robot walks on."""

import copy
import math

import pytest
from geometry_msgs.msg import PoseStamped, Vector3
from sensor_msgs.msg import Imu

from slot_core.messages import decode
from slot_core.robot import TENDON_JOINTS, read_robot
from slot_core.safety.states import State
from slot_msgs.msg import GaitPreview, MpcState, TendonPlan
from slot_msgs.srv import SetGait
from slot_nodes import qos

TOPICS = {
    "odom": (None, qos.SENSOR),
    "imu": (Imu, qos.SENSOR),
    "mpc_state": (MpcState, qos.CONTROL),
    "gait_preview": (GaitPreview, qos.CONTROL),
    "tendon_plan": (TendonPlan, qos.CONTROL),
    "desired_joint_angles": (None, qos.CONTROL),
    "body_pose": (PoseStamped, qos.SENSOR),
}
NAN, INF = math.nan, math.inf
TICKS = 15  # of the controller that must follow: half a second


class Graph:
    """A walking graph, and publishers of the test."""

    def __init__(self, rig):
        self.rig = rig
        self.publishers = {  # those of the nodes: a second one of a command stops the robot
            topic: next(iter(rig.publishers_of(topic)), None)
            or rig.publisher(kind, topic, profile)
            for topic, (kind, profile) in TOPICS.items()
        }
        for topic, (kind, profile) in TOPICS.items():
            if kind is not None:
                rig.subscribe(f"/{topic}", kind, profile)

    def last(self, topic):
        """Newest message of a node."""
        received = self.rig.messages[f"/{topic}"]
        return next(m for m in reversed(received) if m.header.frame_id != "intruder")

    def continues(self):
        """Wait for TICKS commands newer than now; check the range of all commands."""
        begin = self.rig.now()
        commands = self.rig.messages["/desired_joint_angles"]
        self.rig.wait_for(
            lambda: sum(decode.stamp(m) > begin for m in commands) >= TICKS
        )
        assert self.rig.exit_codes == {}
        assert self.rig.state in {State.WALKING, State.HOLD}
        limit = read_robot().tendon.angle_max
        for message in commands:
            if message.header.frame_id != "intruder":
                assert tuple(message.name) == TENDON_JOINTS
                assert all(0.0 <= angle <= limit for angle in message.position)

    def send(self, topic, change):
        """Send a changed copy of the last message of a topic."""
        message = copy.deepcopy(self.last(topic))
        message.header.frame_id = "intruder"
        change(message)
        self.publishers[topic].publish(message)

    def disturb(self, topic, change):
        """Send an invalid copy, with the same stamp, after each of the next TICKS messages."""
        for _ in range(TICKS):
            before = self.last(topic)
            self.rig.wait_for(lambda before=before: self.last(topic) is not before)
            self.send(topic, change)


@pytest.fixture(scope="module")
def made(simulate):
    return Graph(simulate())


@pytest.fixture
def graph(made):
    made.rig.walk_steadily()
    return made


def sets(**values):
    """Function that sets attributes of a message; `__` in a name stands for the dot."""

    def change(message):
        for name, value in values.items():
            *parents, last = name.split("__")
            part = message
            for parent in parents:
                part = getattr(part, parent)
            setattr(part, last, value)

    return change


@pytest.mark.parametrize(
    ("topic", "change"),
    [
        ("desired_joint_angles", sets(position=[NAN] * 4)),
        ("desired_joint_angles", sets(position=[1.0] * 3)),
        ("desired_joint_angles", sets(name=["a", "b", "c", "d"])),
        ("desired_joint_angles", sets(velocity=[NAN] * 4)),
        ("desired_joint_angles", sets(velocity=[1.0] * 3)),
        ("tendon_plan", sets(angle=[NAN] * 88)),
        ("tendon_plan", sets(rate=[INF] * 4)),
        ("tendon_plan", sets(force=[])),
        ("tendon_plan", sets(angle=[1.0] * 7)),
        ("gait_preview", sets(stages=0)),
        ("gait_preview", sets(stages=7)),
        ("gait_preview", sets(stages=2**32 - 1)),  # no array of that size is made
        ("gait_preview", sets(dt=0.0)),
        ("gait_preview", sets(tendon_angle=[])),
        ("gait_preview", sets(tendon_angle=[1.0] * 16)),
        ("gait_preview", sets(tendon_angle=[NAN] * 96)),
        ("mpc_state", sets(position__x=NAN)),
        ("mpc_state", sets(rpy__x=INF, position__z=1e308)),
        ("odom", sets(pose__pose__position__x=NAN)),
        ("odom", sets(pose__pose__orientation__w=0.0)),
        ("imu", sets(angular_velocity__x=NAN)),
    ],
)
def test_invalid_message_with_a_present_stamp_is_refused_and_the_robot_walks_on(
    graph, topic, change
):
    graph.disturb(topic, change)
    graph.continues()


@pytest.mark.parametrize(
    ("topic", "change", "name", "line"),
    [
        (
            "tendon_plan",
            sets(angle=[NAN] * 88),
            "force_mapper",
            "tendon_plan refused: angle[0, 0] = nan: expected a finite number",
        ),
        (
            "mpc_state",
            sets(position__x=NAN),
            "gait_scheduler",
            "mpc_state refused: state[3] = nan: expected a finite number",
        ),
        (
            "desired_joint_angles",
            sets(position=[-0.1] * 4),
            "sim_robot",
            "desired_joint_angles refused: command FL = -0.1 rad is not inside [0, 2.029]",
        ),
    ],
)
def test_refused_message_is_logged_with_value_and_limit(
    graph, topic, change, name, line
):
    graph.send(topic, change)
    graph.rig.run(0.01)
    assert line in graph.rig.log(name)


def test_a_body_pose_is_followed_unless_it_is_invalid_or_out_of_range(graph):
    def command(height, w=1.0):
        pose = PoseStamped()
        pose.pose.position.z, pose.pose.orientation.w = height, w
        graph.publishers["body_pose"].publish(pose)

    assert graph.rig.call(
        SetGait, "/set_gait", gait="walk", velocity=Vector3(x=0.05)
    ).success
    command(0.065)
    graph.rig.wait_for(lambda: graph.last("gait_preview").pose[0] == 0.065)
    for height, w in ((NAN, 1.0), (INF, 1.0), (0.5, 1.0), (0.06, 0.0), (0.06, NAN)):
        command(height, w)
    graph.continues()
    assert graph.last("gait_preview").pose[0] == 0.065
    assert "body_pose refused: " in graph.rig.log("gait_scheduler")
