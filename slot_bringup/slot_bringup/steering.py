"""Steering of a running graph, and the keys for it: velocity, yaw rate and pose of the torso.

A key changes what is commanded by a step, within the reach of the gait. The velocity is repeated
until it is zero; then another source of `/cmd_vel` may steer. With keys it becomes zero where the
supervisor permits no torque: after a stop a robot does not set off as fast as it was before.
"""

import math

import numpy as np
from geometry_msgs.msg import PoseStamped, Twist, TwistStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.gait.gait import read_gaits
from slot_core.messages import decode
from slot_core.robot import BASE_FRAME
from slot_msgs.msg import GaitPreview, RobotState
from slot_nodes import messages, qos

VELOCITY_STEP = 0.01, 0.01, 0.025  # m/s, m/s, rad/s, of a key
POSE_STEP = 0.002, math.radians(1.0), math.radians(1.0)  # m, rad, rad
STOP = "0"
Step = tuple[int, int, int]
# keys of the terminal and of the page: meaning, and sign of the step of v_x, v_y, yaw rate
VELOCITY_KEYS: dict[str, tuple[str, Step]] = {
    "arrowup": ("faster ahead", (1, 0, 0)),
    "arrowdown": ("slower, then back", (-1, 0, 0)),
    "arrowleft": ("turn left", (0, 0, 1)),
    "arrowright": ("turn right", (0, 0, -1)),
    ",": ("aside to the left", (0, 1, 0)),
    ".": ("aside to the right", (0, -1, 0)),
    STOP: ("no velocity", (0, 0, 0)),
}
# of height, roll, pitch
POSE_KEYS: dict[str, tuple[str, Step]] = {
    "u": ("higher", (1, 0, 0)),
    "o": ("lower", (-1, 0, 0)),
    "j": ("roll left", (0, -1, 0)),
    "l": ("roll right", (0, 1, 0)),
    "i": ("nose down", (0, 0, 1)),
    "k": ("nose up", (0, 0, -1)),
}
# sent by a terminal
ARROWS = {
    "\x1b[A": "arrowup",
    "\x1b[B": "arrowdown",
    "\x1b[C": "arrowright",
    "\x1b[D": "arrowleft",
}
HELP = f"arrows ahead, back, turn   , . aside   {STOP} stop   u o height   j l roll   i k pitch"


class SteeringPublisher:
    """Publishes `/cmd_vel` and `/body_pose`, within the reach of the gait that is `commanded`."""

    def __init__(self, node: Node) -> None:
        self._node, self._gaits = node, read_gaits()
        self._velocity: Array | None = None  # (3,) that is repeated
        self._pose: Array | None = None  # (3,) that was commanded last
        self._topic: Publisher | None = None
        # that the graph hears
        self._kind: type[Twist | TwistStamped] = TwistStamped
        self._pose_topic = node.create_publisher(
            PoseStamped, "body_pose", qos.SENSOR
        )

    def steer(self, commanded: GaitPreview, velocity: Array) -> str:
        """Repeat a velocity (3,) from now on, clipped; returns by what, or ""."""
        self._velocity, remark = self._gaits.clipped(
            commanded.requested, velocity
        )
        return remark

    def lean(self, commanded: GaitPreview, pose: Array) -> None:
        """Command height, roll and pitch (3,); raises ConfigError beyond the reach."""
        self._gaits.require_pose(commanded.requested, pose)
        self._pose = pose
        message = PoseStamped(header=messages.header(0))
        message.pose.position.z = float(pose[0])
        q = message.pose.orientation
        q.x, q.y, q.z, q.w = Rotation.from_euler(
            "xyz", [*pose[1:], 0.0]
        ).as_quat()
        self._pose_topic.publish(message)

    def repeat(
        self,
        state: RobotState,
        commanded: GaitPreview | None,
        lasts: bool = False,
    ) -> None:
        """Publish the velocity that is repeated, if any, with the stamp of the supervisor's state.

        lasts: whether the velocity outlasts the torque, as that of a slider does.
        """
        if self._velocity is None:
            return
        self._velocity = self._velocity * (
            lasts or state.action != RobotState.ACTION_OFF
        )
        if self._topic is None:
            plain = any(
                info.topic_type.endswith("/Twist")
                for info in self._node.get_subscriptions_info_by_topic(
                    "cmd_vel"
                )
            )
            self._kind = Twist if plain else TwistStamped
            self._topic = self._node.create_publisher(
                self._kind, "cmd_vel", qos.SENSOR
            )
        message = self._kind()
        twist = message
        if isinstance(message, TwistStamped):
            message.header, twist = (
                messages.header(decode.stamp(state), BASE_FRAME),
                message.twist,
            )
        twist.linear.x, twist.linear.y, twist.angular.z = map(
            float, self._velocity
        )
        self._topic.publish(message)
        if (
            commanded is not None
            and not self._velocity.any()
            and not np.any(commanded.velocity)
        ):
            self._velocity = None


class SteeringKeys(SteeringPublisher):
    """Steering by keys, each of which changes the command by a step."""

    def press(self, key: str, commanded: GaitPreview | None) -> str:
        """Handle a key; return a line on the new command or its refusal, "" for another key."""
        key = ARROWS.get(key, key)
        if key not in VELOCITY_KEYS and key not in POSE_KEYS:
            return ""
        if commanded is None:
            return "no gait_scheduler answers"
        try:
            if key in POSE_KEYS:
                return self._lean(commanded, POSE_KEYS[key][1])
            return self._steer(commanded, VELOCITY_KEYS[key][1])
        except ConfigError as error:
            return str(error)

    def _steer(self, commanded: GaitPreview, step: Step) -> str:
        before = (
            np.array(commanded.velocity)
            if self._velocity is None
            else self._velocity
        )
        remark = self.steer(
            commanded,
            before + np.multiply(step, VELOCITY_STEP)
            if any(step)
            else np.zeros(3),
        )
        assert self._velocity is not None
        v_x, v_y, yaw_rate = self._velocity
        return (
            remark
            or f"velocity {v_x:+.3f} {v_y:+.3f} m/s, {math.degrees(yaw_rate):+.1f} deg/s"
        )

    def _lean(self, commanded: GaitPreview, step: Step) -> str:
        pose = (
            np.array(commanded.pose) if self._pose is None else self._pose
        ) + np.multiply(step, POSE_STEP)
        self.lean(commanded, pose)
        roll, pitch = np.degrees(pose[1:])
        return f"height {1e3 * pose[0]:.0f} mm, roll {roll:+.0f}, pitch {pitch:+.0f} deg"
