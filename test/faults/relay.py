"""Relay of a topic between two nodes, which tests use to change or drop its messages."""

from contextlib import contextmanager

from nav_msgs.msg import Odometry
from real_graph import SLOW_MPC
from sensor_msgs.msg import JointState

from slot_msgs.msg import GaitPreview, GroundReactionForces
from slot_nodes import qos

SOURCES = {
    "odom": ("sim_robot", Odometry, qos.SENSOR),
    "gait_preview": ("gait_scheduler", GaitPreview, qos.CONTROL),
    "ground_reaction_forces": ("mpc_controller", GroundReactionForces, qos.CONTROL),
    "desired_joint_angles": ("force_mapper", JointState, qos.CONTROL),
}
# Time limits as in PATIENT; limits in cycles as in config/: they do not depend on the machine.
FOR_RELAYS = {
    "supervisor": {
        "timing.command_hold": 0.3,
        "timing.command_lost": 2.0,
        "timing.clock_jump": 2.0,
        "timing.heartbeat": 3.0,
        "timing.servo_silent": 2.0,
        "estimate.silence": 0.4,
        "gate.approach_rate": 1.0,  # so low that the rate limit, not the servo, sets the speed
    },
    "mpc": SLOW_MPC,
}


def remaps(*topics):
    """Remaps by node that send the outputs to `<topic>_raw`, the inputs of the relays."""
    return {SOURCES[topic][0]: {topic: f"{topic}_raw"} for topic in topics}


class Relay:
    """Republishes the messages of a topic, changed or not."""

    def __init__(self, rig, topic):
        _, kind, profile = SOURCES[topic]
        self._rig = rig
        self._change = None
        self._out = rig.node.create_publisher(kind, topic, profile)
        rig.node.create_subscription(kind, f"{topic}_raw", self._republish, profile)

    def _republish(self, message):
        if self._change is None or self._change(message) is not False:
            self._out.publish(message)

    @contextmanager
    def changed(self, change):
        """Meanwhile `change` alters each message, or returns False to drop it; yields the start."""
        self._change = change
        try:
            yield self._rig.now()
        finally:
            self._change = None
