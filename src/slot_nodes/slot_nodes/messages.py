"""ROS messages from values of the core; the inverse is slot_core.messages.decode."""

from __future__ import annotations

import dataclasses
import json
import struct
from array import array
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from builtin_interfaces.msg import Duration, Time
from geometry_msgs.msg import Point, Quaternion, TransformStamped, Vector3
from nav_msgs.msg import Odometry
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, Image, Imu, JointState
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from slot_core.arrays import Array
from slot_core.clock import SECOND
from slot_core.gait import gait
from slot_core.geometry import Transform
from slot_core.matrices import product
from slot_core.messages import decode
from slot_core.messages.carried import Carried
from slot_core.robot import (
    BASE_FRAME,
    FLOOR_FRAME,
    FOOTPRINT_FRAME,
    ODOM_FRAME,
    TENDON_JOINTS,
)
from slot_msgs import msg as slot_msgs
from slot_msgs.msg import (
    ForceMapStatus,
    GaitPreview,
    LegStates,
    MpcState,
    RobotState,
    TendonPlan,
)
from slot_msgs.srv import SetGait

# rows of an estimate's covariance in the order of the messages': position, angle; linear, angular
POSE_ORDER = [3, 4, 5, 0, 1, 2]
TWIST_ORDER = [9, 10, 11, 6, 7, 8]
OPTICAL_FRAME = "camera_optical_frame"
CDR_HEADER, STAMP = 4, struct.Struct("<iI")  # its bytes; s, ns
LOST = 9999.0  # variance of lost odometry, as of RTAB-Map

if TYPE_CHECKING:  # a node imports only the core modules that it runs
    from slot_core.control import policy
    from slot_core.control.force_map import TendonCommand
    from slot_core.estimation.estimate import Estimate
    from slot_core.estimation.inertial_filter import Mount
    from slot_core.safety.settings import ServoLimits
    from slot_core.safety.supervisor import Report
    from slot_core.safety.watchdog import ServoHealth
    from slot_core.servos.servo_bus import JointReading
    from slot_core.simulation.readings import (
        ImageReading,
        ImuReading,
        OdometryReading,
        TrueState,
    )
    from slot_core.vision.camera import Camera
    from slot_core.vision.localizer import MarkerFix, NoFix
    from slot_nodes.pace import Pace


def message_class(kind: str) -> type:
    """Class of a message type, package/msg/Name; raises ImportError or AttributeError."""
    package, _, name = kind.split("/")
    return getattr(import_module(f"{package}.msg"), name)


def ns_to_stamp(ns: int) -> Time:
    """ROS time from nanoseconds."""
    return Time(sec=ns // 1_000_000_000, nanosec=ns % 1_000_000_000)


def clock_to_msg(ns: int) -> Clock:
    """Time of a simulation, ns."""
    return Clock(clock=ns_to_stamp(ns))


def header(stamp: int, frame: str = ODOM_FRAME) -> Header:
    """Header at `stamp` (ns) in `frame`."""
    return Header(stamp=ns_to_stamp(stamp), frame_id=frame)


def cdr(message: Any) -> bytes:
    """CDR bytes of a message, or of what is carried in its place."""
    if type(message) is not Carried:
        return serialize_message(message)
    return (
        message.encode()
        if message.encode
        else serialize_message(message.message)
    )


class CdrTemplate:
    """CDR bytes of a message whose stamp and doubles alone change.

    A header's stamp comes first in a message. Where the doubles lie is seen in a message with
    marks in their place.
    """

    def __init__(self, make: Callable[..., Any], *sizes: int) -> None:
        """make: the message of a stamp (ns) and arrays of these sizes."""
        marks = [
            1e6 * (k + 1) + np.arange(size, dtype=float)
            for k, size in enumerate(sizes)
        ]
        self._data = bytearray(serialize_message(make(0, *marks)))
        starts = [self._data.index(mark.tobytes()) for mark in marks]
        self._places = [slice(i, i + 8 * n) for i, n in zip(starts, sizes)]

    def __call__(self, stamp: int, *arrays: Array) -> bytes:
        """The bytes of a stamp (ns) and arrays."""
        STAMP.pack_into(self._data, CDR_HEADER, *divmod(stamp, SECOND))
        for place, values in zip(self._places, arrays):
            self._data[place] = values.tobytes()
        return bytes(self._data)


def prefix_frames(message: Any, prefix: str) -> None:
    """Put a prefix before the frames of a message, or of its parts; empty ones stay so."""
    inside = [
        name for name in ("transforms", "markers") if hasattr(message, name)
    ]
    for part in getattr(message, inside[0]) if inside else [message]:
        if part.header.frame_id:
            part.header.frame_id = prefix + part.header.frame_id
        if hasattr(part, "child_frame_id"):
            part.child_frame_id = prefix + part.child_frame_id


def _doubles(values: Array) -> array[float]:
    """Elements row by row, by their bytes: rclpy would take numbers one by one."""
    return array("d", np.asarray(values, dtype=np.float64).tobytes())


def _vector(values: Array) -> Vector3:
    x, y, z = (float(v) for v in values)
    return Vector3(x=x, y=y, z=z)


def _quaternion(xyzw: Array) -> Quaternion:
    x, y, z, w = (float(v) for v in xyzw)
    return Quaternion(x=x, y=y, z=z, w=w)


def odometry_to_msg(reading: OdometryReading) -> Odometry:
    """Pose in odom, twist in base_link; or that it is lost."""
    return _odometry(*odometry_value(reading)[:5])


def odometry_value(r: OdometryReading) -> tuple[Any, ...]:
    """Value that `decode.odometry` finds in the message."""
    variance = np.full(12, 0.0 if r.quaternion.any() else LOST)
    return (
        r.stamp,
        r.position,
        r.quaternion,
        r.velocity,
        r.angular_velocity,
        variance,
    )


def fix_to_odometry(fix: MarkerFix) -> Odometry:
    """Pose of base_link in odom and twist in base_link from markers, with covariances."""
    message = _odometry(*fix.odometry[:5])
    message.pose.covariance = fix.pose_covariance.ravel()
    message.twist.covariance = fix.twist_covariance.ravel()
    return message


def lost_odometry(fix: NoFix) -> Odometry:
    """Odometry of an image without a pose: zeros, which the state estimator takes as lost."""
    return _odometry(*fix.odometry[:5])


def _odometry(
    stamp: int, position: Array, quaternion: Array, velocity: Array, rate: Array
) -> Odometry:
    """Odometry without covariance; of lost odometry with the covariance of RTAB-Map."""
    message = Odometry(header=header(stamp), child_frame_id=BASE_FRAME)
    x, y, z = (float(v) for v in position)
    message.pose.pose.position = Point(x=x, y=y, z=z)
    message.pose.pose.orientation = _quaternion(quaternion)
    message.twist.twist.linear = _vector(velocity)
    message.twist.twist.angular = _vector(rate)
    if not quaternion.any():
        message.pose.covariance = (LOST * np.eye(6)).ravel()
        message.twist.covariance = message.pose.covariance
    return message


def image_to_msg(reading: ImageReading) -> Image:
    """Grey image, mono8."""
    height, width = reading.grey.shape
    return Image(
        header=header(reading.stamp, OPTICAL_FRAME),
        height=height,
        width=width,
        encoding="mono8",
        step=width,
        data=array("B", reading.grey.tobytes()),
    )


def camera_to_msg(stamp: int, camera: Camera) -> CameraInfo:
    """Calibration of a camera."""
    return CameraInfo(
        header=header(stamp, OPTICAL_FRAME),
        width=camera.width,
        height=camera.height,
        distortion_model=camera.model,
        d=camera.distortion.tolist(),
        k=camera.matrix.ravel(),
        r=np.eye(3).ravel(),
        p=camera.projection.ravel(),
    )


def imu_to_msg(reading: ImuReading) -> Imu:
    """Angular velocity and specific force in base_link; no orientation (REP-145)."""
    message = Imu(header=header(reading.stamp, BASE_FRAME))
    message.orientation_covariance[0] = -1.0
    message.angular_velocity = _vector(reading.angular_velocity)
    message.linear_acceleration = _vector(reading.specific_force)
    return message


def joints_to_msg(reading: JointReading) -> JointState:
    """Tendon angle, rate and servo torque."""
    return JointState(
        header=header(reading.stamp, BASE_FRAME),
        name=TENDON_JOINTS,
        position=reading.angle.tolist(),
        velocity=reading.rate.tolist(),
        effort=reading.torque.tolist(),
    )


def command_to_msg(stamp: int, angle: Array, rate: Array) -> JointState:
    """Desired tendon angles, and the rates for their extrapolation until the next command."""
    return JointState(
        header=header(stamp, BASE_FRAME),
        name=TENDON_JOINTS,
        position=angle.tolist(),
        velocity=rate.tolist(),
    )


def legs_to_msg(truth: TrueState) -> LegStates:
    """Tension, ground force and shape of the legs."""
    return LegStates(
        header=header(truth.stamp),
        tension=truth.tension.tolist(),
        ground_force=[_vector(f) for f in truth.ground_force],
        nodes=truth.nodes.shape[1],
        position=truth.nodes.astype(np.float32).ravel(),
        director=truth.directors.astype(np.float32).ravel(),
    )


def state_to_msg(estimate: Estimate) -> MpcState:
    """The twelve states with covariance and validity."""
    x = estimate.state
    return MpcState(
        header=header(estimate.stamp, FLOOR_FRAME),
        lead=Duration(
            sec=estimate.lead // SECOND, nanosec=estimate.lead % SECOND
        ),
        rpy=_vector(x[0:3]),
        position=_vector(x[3:6]),
        angular_velocity=_vector(x[6:9]),
        linear_velocity=_vector(x[9:12]),
        covariance=estimate.covariance.ravel(),
        validity=int(estimate.validity),
        leg_stiffness=estimate.leg_stiffness,
        legs_are_known=estimate.legs_are_known,
        message=estimate.message,
        gravity=_vector(estimate.gravity),
    )


def state_to_tf(estimate: Estimate) -> TFMessage:
    """Transforms from odom to floor and base_link, and from there to its footprint on the floor."""
    floor = estimate.floor.transform
    base = Transform.of(estimate.state[3:6], estimate.state[0:3])
    x, y, _ = base.position
    footprint = Transform.of((x, y, 0.0), (0.0, 0.0, estimate.state[2]))
    in_odom = base if estimate.floor.is_odom else floor @ base
    return TFMessage(
        transforms=[
            _transform(header(estimate.time), FLOOR_FRAME, floor),
            _transform(header(estimate.time), BASE_FRAME, in_odom),
            _transform(
                header(estimate.time, BASE_FRAME),
                FOOTPRINT_FRAME,
                base.inverse @ footprint,
            ),
        ]
    )


def mounts_to_tf(*mounts: Mount) -> TFMessage:
    """Transforms from base_link to the frames of sensors; none for a sensor in base_link."""
    return TFMessage(
        transforms=[
            _transform(
                header(0, BASE_FRAME), m.frame, Transform.of(m.position, m.rpy)
            )
            for m in mounts
            if m.frame != BASE_FRAME
        ]
    )


def _transform(head: Header, child: str, place: Transform) -> TransformStamped:
    """Place of a frame in the frame of the header."""
    made = TransformStamped(header=head, child_frame_id=child)
    made.transform.translation = _vector(place.position)
    made.transform.rotation = _quaternion(place.quaternion)
    return made


def estimate_to_odometry(estimate: Estimate) -> Odometry:
    """Pose in odom, twist in base_link, with covariances (REP-105); angles as roll, pitch, yaw."""
    x, cov = estimate.state, estimate.covariance
    base = Transform.of(x[3:6], x[0:3])
    message = Odometry(header=header(estimate.time), child_frame_id=BASE_FRAME)
    pose, twist = message.pose, message.twist
    pose.pose.position = Point(x=float(x[3]), y=float(x[4]), z=float(x[5]))
    pose.pose.orientation = _quaternion(base.quaternion)
    to_base = base.rotation.T
    twist.twist.linear = _vector(product(to_base, x[9:12]))
    twist.twist.angular = _vector(product(to_base, x[6:9]))
    pose.covariance = cov[np.ix_(POSE_ORDER, POSE_ORDER)].ravel()
    both = np.kron(np.eye(2), to_base)
    turned = product(both, cov[np.ix_(TWIST_ORDER, TWIST_ORDER)])
    twist.covariance = product(turned, both.T).ravel()
    return message


def preview_to_msg(preview: gait.GaitPreview) -> GaitPreview:
    """Gait preview, arrays row-major."""
    return GaitPreview(
        header=header(preview.stamp, FLOOR_FRAME),
        gait=preview.gait,
        phase=preview.phase,
        period=preview.period,
        dt=preview.dt,
        stages=len(preview.contact),
        contact=preview.contact.ravel().tolist(),
        friction=_doubles(preview.friction),
        normal_force=_doubles(preview.normal_force),
        tendon_angle=_doubles(preview.tendon_angle),
        reference=_doubles(preview.reference),
        velocity_ahead=_doubles(preview.velocity_ahead),
        corrected=preview.corrected,
        requested=preview.command.gait,
        followed=preview.command.followed,
        velocity=preview.command.velocity,
        pose=preview.command.pose,
        leg_stiffness=preview.leg_stiffness,
        remark=preview.remark,
    )


def plan_to_msg(
    plan: policy.TendonPlan,
    preview: gait.GaitPreview,
    elapsed: float,
    pace: Pace,
    changes: Mapping[str, Any] | None = None,
) -> TendonPlan:
    """Plan for a preview with its stamp; `elapsed`: time of the policy's step, s.

    changes: settings of the policy that were changed while it ran, by dotted name.
    """
    report = vars(plan.report)
    arrays = [
        name for name, value in report.items() if isinstance(value, np.ndarray)
    ]
    return TendonPlan(
        header=header(preview.stamp, FLOOR_FRAME),
        dt=preview.dt,
        stages=len(plan.force),
        angle=_doubles(plan.angle),
        rate=plan.rate.tolist(),
        force=_doubles(plan.force),
        pose=_doubles(plan.pose),
        foot=array("f", plan.foot.astype(np.float32).tobytes()),
        map=plan.map,
        status=int(plan.status),
        message=plan.message,
        fallback_cycles=plan.fallback_cycles,
        solve_time=elapsed,
        overruns=pace.overruns,
        skipped=pace.skipped,
        period=preview.period,
        velocity=preview.velocity_ahead[0],
        remark=preview.remark,
        settings=json.dumps(changes) if changes else "",
        **report | {name: report[name].tolist() for name in arrays},
    )


def map_status_to_msg(stamp: int, command: TendonCommand) -> ForceMapStatus:
    """Map of a plan to tendon angles: slopes, unclamped angles, saturation."""
    return ForceMapStatus(
        header=header(stamp, FLOOR_FRAME),
        map=command.map,
        force=command.force.tolist(),
        slope=command.slope.tolist(),
        angle_unclamped=command.angle_unclamped.tolist(),
        saturated=command.saturated.tolist(),
    )


def health_to_msg(stamp: int, health: ServoHealth) -> slot_msgs.ServoHealth:
    """Health of the servos."""
    return slot_msgs.ServoHealth(
        header=header(stamp, BASE_FRAME),
        action=decode.ACTION_NUMBERS.index(health.action),
        reason=health.reason,
        commanded=ns_to_stamp(health.commanded),
        written=ns_to_stamp(health.written),
        torque=health.torque.tolist(),
        silence=health.silence,
        goal=health.goal,
        slewed=health.slewed.tolist(),
        temperature=health.temperature,
        voltage=health.voltage,
        hardware_error=health.hardware_error.astype(np.uint8),
        error_rate=health.error_rate,
        supervised=ns_to_stamp(health.supervised),
    )


def limits_to_msg(limits: ServoLimits) -> slot_msgs.ServoLimits:
    """Limits for the driver of the servos, real or simulated."""
    values = dataclasses.asdict(limits)
    return slot_msgs.ServoLimits(**values.pop("gate"), **values)


def robot_state_to_msg(stamp: int, report: Report) -> RobotState:
    """State of the robot and action of the servos."""
    return RobotState(
        header=header(stamp, BASE_FRAME),
        state=int(report.state),
        action=decode.ACTION_NUMBERS.index(report.action),
        followed=report.followed,
        reason=report.reason,
        since=ns_to_stamp(report.since),
        warnings=list(report.warnings),
        slack=report.slack,
    )


def gait_request(
    name: str, v_x: float, v_y: float, yaw_rate: float
) -> SetGait.Request:
    """Request of a gait at a velocity (m/s) and yaw rate (rad/s) in base_link."""
    return SetGait.Request(
        gait=name, velocity=Vector3(x=v_x, y=v_y, z=yaw_rate)
    )
