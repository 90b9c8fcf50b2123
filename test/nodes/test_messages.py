"""Encoding, serialisation by DDS and decoding of messages return the same values."""

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped, TransformStamped
from nav_msgs.msg import Odometry
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from tf2_msgs.msg import TFMessage

from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.floor_observer import FloorPlane
from slot_core.estimation.inertial_filter import Mount
from slot_core.gait.gait import GaitCommand, GaitPreview
from slot_core.geometry import Transform, matrix_of_quaternion
from slot_core.messages import decode
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action, State
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.readings import ImuReading, OdometryReading, TrueState
from slot_msgs.msg import RobotState
from slot_nodes import messages

STAMP = 1_234_567_890_123_456_789
LEAD = 43_000_001
RNG = np.random.default_rng(0)


def through_dds(message):
    return deserialize_message(serialize_message(message), type(message))


TURN = Rotation.random(rng=RNG).as_quat()
PLACE, VELOCITY, RATE = RNG.normal(size=(3, 3))


@pytest.mark.parametrize(
    ("sent", "encode", "read"),
    [
        (
            OdometryReading(STAMP, PLACE, TURN, VELOCITY, RATE),
            messages.odometry_to_msg,
            decode.odometry,
        ),
        (ImuReading(STAMP, RATE, PLACE), messages.imu_to_msg, decode.imu),
    ],
)
def test_a_reading_and_its_unknown_uncertainty(sent, encode, read):
    message = through_dds(encode(sent))
    stamp, *found = read(message)
    assert stamp == STAMP
    for got, want in zip(found, [*vars(sent).values()][1:]):
        assert (got == want).all()
    if read is decode.imu:
        assert message.orientation_covariance[0] == -1  # REP-145
    else:
        frames = message.header.frame_id, message.child_frame_id
        assert frames == ("odom", "base_link")
        assert (found[-1] == np.zeros(12)).all()


@pytest.mark.parametrize(
    ("kind", "encode", "sizes"),
    [
        (OdometryReading, messages.odometry_to_msg, (3, 4, 3, 3)),
        (ImuReading, messages.imu_to_msg, (3, 3)),
        (JointReading, messages.joints_to_msg, (4, 4, 4)),
    ],
)
def test_a_template_gives_the_bytes_of_every_message(kind, encode, sizes):
    template = messages.CdrTemplate(lambda *v: encode(kind(*v)), *sizes)
    for stamp in (STAMP, 5, STAMP - 1):
        arrays = [RNG.normal(size=size) for size in sizes]
        message = through_dds(encode(kind(stamp, *arrays)))
        got = deserialize_message(template(stamp, *arrays), type(message))
        assert got == message


def test_a_prefix_is_put_before_every_frame_of_a_message():
    message = Odometry(header=messages.header(0), child_frame_id="base_link")
    messages.prefix_frames(message, "fred/")
    assert (message.header.frame_id, message.child_frame_id) == (
        "fred/odom",
        "fred/base_link",
    )
    transforms = TFMessage(
        transforms=[TransformStamped(header=messages.header(0))]
    )
    messages.prefix_frames(transforms, "fred/")
    assert transforms.transforms[0].header.frame_id == "fred/odom"
    unframed = DiagnosticArray()
    messages.prefix_frames(unframed, "fred/")
    assert unframed.header.frame_id == ""


def test_state_and_its_transform():
    state = np.concatenate([[0.1, -0.2, 2.0], RNG.normal(size=9)])
    floor = FloorPlane(0.2, np.array([0.0, -0.6, 0.8]))
    estimate = Estimate(
        STAMP,
        state,
        RNG.normal(size=(12, 12)),
        Validity.IMU_MISSING,
        LEAD,
        0.8,
        False,
        "a line",
        floor,
        np.array([0.5, -0.2, -9.7]),
    )
    got = decode.estimate(through_dds(messages.state_to_msg(estimate)))
    assert (got.stamp, got.validity, got.lead) == (STAMP, 3, LEAD)
    assert (got.leg_stiffness, got.legs_are_known) == (0.8, False)
    assert got.message == "a line"
    assert (got.gravity == estimate.gravity).all()
    assert (got.state == state).all()
    assert (got.covariance == estimate.covariance).all()
    transforms = through_dds(messages.state_to_tf(estimate)).transforms
    assert [
        (t.header.frame_id, t.child_frame_id, decode.stamp(t))
        for t in transforms
    ] == [
        ("odom", "floor", STAMP + LEAD),
        ("odom", "base_link", STAMP + LEAD),
        ("base_link", "base_footprint", STAMP + LEAD),
    ]
    plane, base, below = (as_transform(t.transform) for t in transforms)
    # the floor's normal, and a point of it, in odom
    assert plane.apply(np.array([0.0, 0.0, 1.0])) == pytest.approx(
        [0.0, -0.6, 1.0]
    )
    on_floor = plane.inverse @ base
    yaw_pitch_roll = Rotation.from_matrix(on_floor.rotation).as_euler("ZYX")
    assert yaw_pitch_roll == pytest.approx([2.0, -0.2, 0.1])
    place = on_floor @ below  # level, with the torso's yaw
    assert place.position == pytest.approx([*state[3:5], 0.0])
    assert place.rotation == pytest.approx(
        Rotation.from_euler("z", 2.0).as_matrix()
    )


def as_transform(message):
    q = message.rotation
    rotation = matrix_of_quaternion([q.x, q.y, q.z, q.w])
    return Transform(rotation, decode.vector(message.translation))


def test_an_estimate_as_odometry_has_twist_and_covariances_in_their_frames():
    root = RNG.normal(size=(12, 12))
    state = np.concatenate([[0.1, -0.2, 2.0], RNG.normal(size=9)])
    estimate = Estimate(STAMP, state, root @ root.T, Validity.VALID, LEAD)
    message = through_dds(messages.estimate_to_odometry(estimate))
    assert (message.header.frame_id, message.child_frame_id) == (
        "odom",
        "base_link",
    )
    stamp, position, quaternion, velocity, rate, variance = decode.odometry(
        message
    )
    attitude = Rotation.from_euler("ZYX", [2.0, -0.2, 0.1])
    assert stamp == STAMP + LEAD
    assert position == pytest.approx(state[3:6])
    assert quaternion == pytest.approx(attitude.as_quat())
    assert attitude.apply(velocity) == pytest.approx(state[9:12])
    assert attitude.apply(rate) == pytest.approx(state[6:9])
    assert variance[:6] == pytest.approx(np.diag(estimate.covariance)[:6])
    turn = attitude.as_matrix()
    along_x = turn[:, 0] @ estimate.covariance[9:12, 9:12] @ turn[:, 0]
    assert variance[6] == pytest.approx(along_x)


def test_the_mount_of_a_sensor_is_a_transform_from_base_link():
    camera = Mount("camera_link", (0.1, 0.0, 0.03), (0.0, 0.3, np.pi))
    imu = Mount("base_link", (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    (place,) = through_dds(messages.mounts_to_tf(imu, camera)).transforms
    assert (place.header.frame_id, place.child_frame_id) == (
        "base_link",
        "camera_link",
    )
    q = place.transform.rotation
    assert [q.x, q.y, q.z, q.w] == pytest.approx(
        Rotation.from_euler("ZYX", [np.pi, 0.3, 0.0]).as_quat()
    )
    assert place.transform.translation.x == 0.1


def test_preview():
    shape = (15, 4)
    sent = GaitPreview(
        stamp=STAMP,
        gait="walk",
        phase=0.3,
        period=0.7,
        dt=0.033,
        contact=RNG.random(shape) > 0.5,
        friction=RNG.random(shape),
        normal_force=RNG.random(shape),
        tendon_angle=RNG.random(shape),
        reference=RNG.random((15, 12)),
        velocity_ahead=RNG.random((15, 3)),
        corrected=True,
        command=GaitCommand("stand", RNG.random(3), RNG.random(3)),
        remark="clipped",
    )
    got = decode.preview(through_dds(messages.preview_to_msg(sent)))
    assert got.command.gait == "stand"
    assert (got.command.velocity == sent.command.velocity).all()
    assert (got.command.pose == sent.command.pose).all()
    for name in vars(sent).keys() - {"command"}:
        assert np.array_equal(getattr(got, name), getattr(sent, name)), name


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_a_body_pose_is_height_roll_and_pitch_at_any_yaw(yaw):
    """Roll, pitch and yaw are about the fixed axes x, y, z in this order."""
    message = PoseStamped()
    message.pose.position.x, message.pose.position.z = 3.0, 0.045
    q = Rotation.from_euler("ZYX", [yaw, -0.06, 0.08]).as_quat()
    o = message.pose.orientation
    o.x, o.y, o.z, o.w = q
    assert decode.body_pose(through_dds(message)) == pytest.approx(
        [0.045, 0.08, -0.06]
    )


def test_joint_angles_are_read_by_name_not_by_position():
    angles, rates = np.array([[0.1, 0.2, 0.3, 0.4], [1.0, 2.0, 3.0, 4.0]])
    message = messages.command_to_msg(STAMP, angles, rates)
    message.name = list(message.name)[::-1]
    received = through_dds(message)
    stamp, angle = decode.joint_angles(received)
    assert (stamp, angle.tolist()) == (STAMP, [0.4, 0.3, 0.2, 0.1])
    assert decode.joint_command(received)[2].tolist() == [4.0, 3.0, 2.0, 1.0]


def test_a_command_without_velocities_stays():
    message = messages.command_to_msg(STAMP, np.ones(4), np.ones(4))
    message.velocity = []
    assert decode.joint_command(through_dds(message))[2].tolist() == [0.0] * 4
    message.velocity = [1.0]
    with pytest.raises(ValueError, match="once each"):
        decode.joint_command(message)


def test_limits_and_permission_of_the_servos():
    limits = read_supervisor().servo_limits
    message = through_dds(messages.limits_to_msg(limits))
    assert decode.servo_limits(message) == limits
    for state in (State.STANDING, State.WALKING):
        sent = RobotState(state=int(state), action=RobotState.ACTION_PASS)
        found = decode.permission(through_dds(sent), STAMP)
        walks = state is State.WALKING
        assert (found.action, found.walks) == (Action.PASS, walks)


@pytest.mark.parametrize("segments", [6, 0])
def test_legs_with_and_without_directors(segments):
    odometry = OdometryReading(STAMP, *RNG.normal(size=(4, 3)))
    shape = RNG.normal(size=(4, 7, 3)), RNG.normal(size=(4, segments, 3))
    sent = TrueState(
        STAMP, odometry, RNG.normal(size=4), RNG.normal(size=(4, 3)), *shape
    )
    message = through_dds(messages.legs_to_msg(sent))
    assert message.header.frame_id == "odom"
    stamp, tension, force, nodes, directors = decode.legs(message)
    assert stamp == STAMP
    assert (tension == sent.tension).all()
    assert (force == sent.ground_force).all()
    assert (nodes == sent.nodes.astype(np.float32)).all()
    assert (directors == sent.directors.astype(np.float32)).all()
    assert directors.shape == (4, segments, 3)
