"""Decodes messages of the graph into the core's values.

Independent of ROS: the functions only read attributes, so they decode rclpy's messages in the nodes
as well as the messages that the `rosbags` library reads from a bag. The value of a message of the
same process is there already (`carried.py`).
"""

import math
from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from slot_core import config
from slot_core.arrays import Array
from slot_core.control.policy import Status, TendonPlan
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.inertial_filter import DOWN
from slot_core.faults import Fault
from slot_core.gait.gait import GaitCommand, GaitPreview
from slot_core.geometry import matrix_of_quaternion, rpy_of
from slot_core.messages.carried import Carried
from slot_core.refusal import quoted
from slot_core.robot import BASE_FRAME, LEGS, TENDON_JOINTS
from slot_core.safety.settings import GateSettings, ServoLimits
from slot_core.safety.states import Action, State
from slot_core.safety.watchdog import Permission, ServoHealth

T = TypeVar("T")
LONGEST_SOURCE = 60  # characters of a name in lines
# as in RobotState
ACTION_NUMBERS = (Action.OFF, Action.RELAX, Action.HOLD, Action.PASS)


def carries(decode: Callable[[Any], T]) -> Callable[[Any], T]:
    """Let a decoder return the value of a message that is `Carried`."""

    @wraps(decode)
    def decoded(message: Any) -> T:
        if type(message) is Carried:
            return message.value
        return decode(message)

    return decoded


def stamp(message: Any) -> int:
    """Nanoseconds of the header's stamp."""
    if type(message) is Carried:
        return message.stamp
    return time(message.header.stamp)


def time(message: Any) -> int:
    """Nanoseconds of a Time."""
    return int(message.sec) * 1_000_000_000 + int(message.nanosec)


def vector(message: Any) -> Array:
    """(3,) of a Vector3 or Point."""
    return np.array([message.x, message.y, message.z])


def odometry(message: Any) -> tuple[int, Array, Array, Array, Array, Array]:
    """(stamp, position, quaternion xyzw, velocity, angular velocity, variance), twist in base_link.

    variance (12,) of angle, position, velocity and rate: the diagonals of the covariances; zero
    where they are unknown.
    """
    pose, twist = message.pose.pose, message.twist.twist
    pose_variance = np.array(message.pose.covariance)[::7]  # of position, angle
    q = pose.orientation
    return (
        stamp(message),
        vector(pose.position),
        np.array([q.x, q.y, q.z, q.w]),
        vector(twist.linear),
        vector(twist.angular),
        np.concatenate(
            [
                pose_variance[3:],
                pose_variance[:3],
                np.array(message.twist.covariance)[::7],  # of velocity, rate
            ]
        ),
    )


@carries
def torso_odometry(
    message: Any,
) -> tuple[int, Array, Array, Array, Array, Array]:
    """As `odometry`; raises ValueError if its child frame is not base_link."""
    if message.child_frame_id.rpartition("/")[2] != BASE_FRAME:
        raise ValueError(
            f"child_frame_id {quoted(message.child_frame_id)}: expected {BASE_FRAME!r}"
        )
    return odometry(message)


@carries
def imu(message: Any) -> tuple[int, Array, Array]:
    """(stamp, angular velocity, specific force), both in the IMU's frame.

    Raises ValueError for a message without one of them: covariance[0] is -1 (REP 145).
    """
    for name in ("angular_velocity", "linear_acceleration"):
        if getattr(message, f"{name}_covariance")[0] == -1.0:
            raise ValueError(f"no {name}: its covariance begins with -1")
    return (
        stamp(message),
        vector(message.angular_velocity),
        vector(message.linear_acceleration),
    )


def velocity(message: Any) -> tuple[int, Array]:
    """(stamp, [v_x, v_y, yaw rate]) of a TwistStamped in base_link, or of a Twist with stamp 0."""
    when, twist = (
        (stamp(message), message.twist)
        if hasattr(message, "header")
        else (0, message)
    )
    return when, np.array([twist.linear.x, twist.linear.y, twist.angular.z])


def body_pose(message: Any) -> Array:
    """(3,) height, roll, pitch of a PoseStamped; raises ValueError for a zero quaternion."""
    q = message.pose.orientation
    roll, pitch, _ = rpy_of(matrix_of_quaternion([q.x, q.y, q.z, q.w]))
    return np.array([message.pose.position.z, roll, pitch])


def joint_angles(message: Any) -> tuple[int, Array]:
    """(stamp, angles in the order of LEGS); raises ValueError unless each joint is named once."""
    return stamp(message), _of_joints(message, message.position)


@carries
def joint_command(message: Any) -> tuple[int, Array, Array]:
    """(stamp, angles, rates in the order of LEGS); raises ValueError as `joint_angles`.

    Without velocities the rates are zero.
    """
    rate = (
        _of_joints(message, message.velocity)
        if len(message.velocity)
        else np.zeros(len(LEGS))
    )
    return *joint_angles(message), rate


@carries
def joint_loads(message: Any) -> tuple[int, Array, Array]:
    """(stamp, angles, torques in the order of LEGS); raises ValueError as `joint_angles`."""
    return *joint_angles(message), _of_joints(message, message.effort)


def _of_joints(message: Any, values: Any) -> Array:
    names = list(message.name)
    if sorted(names) != sorted(TENDON_JOINTS) or len(values) != len(LEGS):
        raise ValueError(
            f"joints {quoted(names)}: expected {', '.join(TENDON_JOINTS)} once each"
        )
    return np.array([values[names.index(joint)] for joint in TENDON_JOINTS])


@carries
def estimate(message: Any) -> Estimate:
    """Estimate of an MpcState; raises ValueError on an unknown validity."""
    return Estimate(
        stamp(message),
        np.concatenate(
            [
                vector(message.rpy),
                vector(message.position),
                vector(message.angular_velocity),
                vector(message.linear_velocity),
            ]
        ),
        np.array(message.covariance).reshape(12, 12),
        Validity(message.validity),
        time(message.lead),
        getattr(message, "leg_stiffness", 1.0),  # older bags have none
        getattr(message, "legs_are_known", True),
        getattr(message, "message", ""),
        gravity=vector(message.gravity)
        if hasattr(message, "gravity")
        else DOWN,
    )


@carries
def preview(message: Any) -> GaitPreview:
    """Gait preview; raises ValueError if an array does not have the stated number of stages."""
    is_older = not hasattr(message, "velocity_ahead")  # of a bag
    ahead = (
        np.zeros((message.stages, 3))
        if is_older
        else _of_stages(message, "velocity_ahead", 3)
    )
    return GaitPreview(
        stamp=stamp(message),
        gait=message.gait,
        phase=message.phase,
        period=message.period,
        dt=message.dt,
        contact=_of_stages(message, "contact", 4).astype(bool),
        friction=_of_stages(message, "friction", 4),
        normal_force=_of_stages(message, "normal_force", 4),
        tendon_angle=_of_stages(message, "tendon_angle", 4),
        reference=_of_stages(message, "reference", 12),
        velocity_ahead=ahead,
        corrected=is_older or message.corrected,
        command=GaitCommand(
            message.requested,
            np.array(message.velocity),
            np.array(message.pose),
            getattr(message, "followed", True),  # not in older bags
        ),
        remark=getattr(message, "remark", ""),
        leg_stiffness=getattr(message, "leg_stiffness", 1.0),
    )


@carries
def plan(message: Any) -> tuple[int, TendonPlan]:
    """(stamp, plan) without its report; raises ValueError if an array does not fit its stages."""
    legs = len(LEGS)
    return stamp(message), TendonPlan(
        angle=_of_stages(message, "angle", legs, optional=True),
        rate=np.array(message.rate),
        force=_of_stages(message, "force", legs, 3),
        status=Status(message.status),
        message=message.message,
        map=message.map,
        fallback_cycles=int(message.fallback_cycles),
        pose=_of_stages(message, "pose", 6, optional=True),
        foot=_of_stages(message, "foot", legs, 3, optional=True),
    )


def _of_stages(
    message: Any, name: str, *shape: int, optional: bool = False
) -> NDArray[Any]:
    """An array of so many values a stage, (stages, *shape), or (0, *shape) of an optional one.

    Raises ValueError for another number of values.
    """
    stages, each = int(message.stages), math.prod(shape)
    values = np.array(getattr(message, name, ()))
    if optional and not values.size:
        return values.reshape(0, *shape)
    if stages < 1 or values.size != stages * each:
        raise ValueError(
            f"{name} has {values.size} values, not {stages} stages of {each}"
        )
    return values.reshape(stages, *shape)


def legs(message: Any) -> tuple[int, Array, Array, Array, Array]:
    """(stamp, tension (4,) N, ground force (4, 3) N, nodes (4, n, 3) m, directors), all in odom.

    directors: (4, n - 1, 3), or (4, 0, 3) where the legs have none, as in messages recorded before
    the field existed. Raises ValueError if positions or directors do not fit the stated number
    of nodes, or are not finite.
    """
    count, position = (
        int(message.nodes),
        np.array(message.position, dtype=np.float64),
    )
    director = np.array(getattr(message, "director", ()), dtype=np.float64)
    row = 3 * len(LEGS)
    for name, values, sizes in (
        ("position", position, {row * count}),
        ("director", director, {0, row * (count - 1)}),
    ):
        if count < 2 or values.size not in sizes:
            raise ValueError(
                f"{name} has {values.size} values, not 4 legs of {count} nodes"
            )
        if not np.isfinite(values).all():
            raise ValueError(f"{name}: expected finite numbers")
    return (
        stamp(message),
        np.array(message.tension),
        np.array([vector(force) for force in message.ground_force]),
        position.reshape(len(LEGS), count, 3),
        director.reshape(len(LEGS), -1, 3),
    )


def robot_state(message: Any) -> tuple[int, State, Action, str]:
    """(stamp, state, action of the servos, reason); raises ValueError on unknown numbers."""
    return (
        stamp(message),
        State(message.state),
        _action(message.action),
        message.reason,
    )


def permission(message: Any, now: int) -> Permission:
    """Permission of a RobotState received at `now` (ns); raises ValueError on unknown numbers."""
    sent, state, action, reason = robot_state(message)
    return Permission(
        now,
        action,
        message.followed,
        reason,
        sent,
        walks=state is State.WALKING,
    )


@carries
def servo_health(message: Any) -> tuple[int, ServoHealth]:
    """(stamp, health); raises ValueError on an unknown action."""
    return stamp(message), ServoHealth(
        action=_action(message.action),
        reason=message.reason,
        torque=np.array(message.torque, dtype=bool),
        silence=np.array(message.silence, dtype=np.float64),
        goal=np.array(message.goal, dtype=np.float64),
        slewed=np.array(message.slewed, dtype=bool),
        hardware_error=np.array(message.hardware_error, dtype=np.int64),
        temperature=np.array(message.temperature, dtype=np.float64),
        voltage=np.array(message.voltage, dtype=np.float64),
        error_rate=np.array(message.error_rate, dtype=np.float64),
        commanded=time(message.commanded),
        written=time(message.written),
        supervised=time(message.supervised)
        if hasattr(message, "supervised")
        else 0,  # an old bag
    )


def emergency_stop(message: Any) -> tuple[str, bool, bool]:
    """(source, pressed, leaving) of the e-stop; whatever the name, the message counts."""
    name = "".join(
        c if c.isprintable() else "?" for c in message.source[:LONGEST_SOURCE]
    )
    return name or "a source without a name", message.pressed, message.leaving


def servo_limits(message: Any) -> ServoLimits:
    """Limits of whatever drives the servos; raises ConfigError on one out of bounds."""
    gate, limits = (
        {
            field.name: getattr(message, field.name)
            for field in fields(kind)
            if field.name != "gate"
        }
        for kind in (GateSettings, ServoLimits)
    )
    return config.build(
        ServoLimits, limits | {"gate": gate}, "servo_limits: message"
    )


def _action(number: int) -> Action:
    if number >= len(ACTION_NUMBERS):
        raise ValueError(
            f"action {number}: expected at most {len(ACTION_NUMBERS) - 1}"
        )
    return ACTION_NUMBERS[number]


def fault(request: Any) -> Fault:
    """Fault of a request to inject one, at time 0 s; raises ConfigError if it is invalid."""
    names = ("kind", "leg", "duration", "value")
    wanted = {name: getattr(request, name) for name in names}
    return config.build(Fault, wanted | {"time": 0.0}, "inject: fault")
