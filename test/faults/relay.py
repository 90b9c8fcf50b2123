"""A topic that passes through the tests' hands."""

from contextlib import contextmanager

from nav_msgs.msg import Odometry
from sensor_msgs.msg import JointState

from slot_msgs.msg import GaitPreview, GroundReactionForces
from slot_nodes import qos

SOURCES = {
    "odom": ("sim_robot", Odometry, qos.SENSOR),
    "gait_preview": ("gait_scheduler", GaitPreview, qos.CONTROL),
    "ground_reaction_forces": ("mpc_controller", GroundReactionForces, qos.CONTROL),
    "desired_joint_angles": ("force_mapper", JointState, qos.CONTROL),
}
# As PATIENT, but what is counted in cycles stays: that does not depend on the machine. Standing up
# is so slow that the servos alone would be seen to be faster.
FOR_RELAYS = {
    "supervisor.yaml": {
        "slack_max: 1.4e-3": "slack_max: 2.0e-2",  # late commands are not the tendons' fault
        "command_hold: 0.1": "command_hold: 0.3", "command_lost: 0.5": "command_lost: 2.0",
        "clock_jump: 0.5": "clock_jump: 2.0", "heartbeat: 0.5": "heartbeat: 3.0",
        "servo_silent: 0.5": "servo_silent: 2.0", "period: 0.033": "period: 0.1",
        "approach_rate: 2.0": "approach_rate: 1.0",
    },
    "mpc.yaml": {"time_budget: 0.02": "time_budget: 0.2"},
}  # fmt: skip


def remaps(*topics):
    """By node, what takes its output out of the graph, to be relayed."""
    return {SOURCES[topic][0]: {topic: f"{topic}_raw"} for topic in topics}


class Relay:
    """Passes the messages of a topic on, changed or not."""

    def __init__(self, rig, topic):
        _, kind, profile = SOURCES[topic]
        self._rig = rig
        self._change = None
        self._out = rig.node.create_publisher(kind, topic, profile)
        rig.node.create_subscription(kind, f"{topic}_raw", self._pass, profile)

    def _pass(self, message):
        if self._change is None or self._change(message) is not False:
            self._out.publish(message)

    @contextmanager
    def changed(self, change):
        """Meanwhile `change` alters each message, or returns False to drop it; gives the begin."""
        self._change = change
        try:
            yield self._rig.now()
        finally:
            self._change = None
