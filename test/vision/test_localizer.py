"""Marker localisation: the torso's pose from rendered images, and images without one.

The node marker_localizer: images and calibration in, odometry or lost odometry out.
"""

import dataclasses

import numpy as np
import pytest
from rig import Rig
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image
from views import CAMERA, MOUNT, VISION, board, image_from_torso, synthetic

from slot_core import config
from slot_core.clock import SECOND
from slot_core.geometry import Transform
from slot_core.messages import decode
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.readings import ImageReading
from slot_core.vision.board import print_of, single_marker
from slot_core.vision.camera import Camera, CameraError
from slot_core.vision.detector import MarkerDetector
from slot_core.vision.localizer import MarkerFix, MarkerLocalizer, NoFix
from slot_core.vision.synthetic_camera import Surface
from slot_nodes import messages, qos

BLANK = np.full((720, 1280), 120, np.uint8)
BASE = Transform.of((0.15, -0.03, 0.07), (0.06, -0.05, 0.08))


def localizer(settings=VISION, camera=CAMERA):
    return MarkerLocalizer(settings, camera, MOUNT, "torso")


def changed(**changes):
    return config.replace(VISION, changes)


def test_the_pose_is_that_of_the_torso_within_its_covariance():
    fix = localizer().locate(5, image_from_torso(BASE))
    assert isinstance(fix, MarkerFix)
    turn = (
        Rotation.from_quat(fix.quaternion)
        * Rotation.from_matrix(BASE.rotation).inv()
    )
    error = np.concatenate([fix.position - BASE.position, turn.as_rotvec()])
    assert np.abs(error[:3]).max() < 2e-3
    assert np.abs(error[3:]).max() < 5e-3
    # six values
    assert error @ np.linalg.solve(fix.pose_covariance, error) < 30.0
    assert np.sqrt(np.diag(fix.pose_covariance)).max() < 6e-3


def test_velocity_and_rate_are_the_difference_of_two_poses():
    located, dt = localizer(), 0.033
    moved = Transform.of((0.155, -0.03, 0.07), (0.06, -0.05, 0.09))
    for _ in range(5):  # an image that repeats its stamp changes nothing
        first = located.locate(0, image_from_torso(BASE))
        assert np.diag(first.twist_covariance).min() >= 1e6  # unknown
    fix = located.locate(round(dt * SECOND), image_from_torso(moved))
    expected = moved.rotation.T @ (moved.position - BASE.position) / dt
    turn = (
        Rotation.from_matrix(BASE.rotation.T @ moved.rotation).as_rotvec() / dt
    )
    np.testing.assert_allclose(fix.velocity, expected, atol=0.03)
    np.testing.assert_allclose(fix.angular_velocity, turn, atol=0.06)
    late = VISION.detection.acceleration * dt / 2
    assert np.diag(fix.twist_covariance)[:3].min() > late**2


def reason(located, image, images=1):
    for number in range(images):
        fix = located.locate(number, image)
    assert isinstance(fix, NoFix)
    assert not fix.odometry[2].any()  # the quaternion of lost odometry
    return fix.reason


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"dictionary": "DICT_5X5_100"}, "no marker of DICT_5X5_100"),
        (
            {"boards.wall.frame": "base_link"},
            "no marker of the boards, only ids 0, 1",
        ),
    ],
)
def test_an_image_without_markers_of_the_boards_has_no_pose(settings, said):
    located = localizer(settings=changed(**settings))
    assert said in reason(located, image_from_torso(BASE), images=10)


def test_an_id_seen_twice_is_not_used_while_only_a_part_of_the_image_is_searched():
    """The search around the other markers may hold one of the two only."""
    # id 0 is of the board too
    wall, single = (board("wall"), single_marker(0, 0.05))
    places = (wall, (0.0, 0.0, 1.8)), (single, (-0.75, 0.0, 1.8))
    sheets = [
        Surface(
            print_of(each, VISION.dictionary_number),
            Transform.of(at, (np.pi, 0.0, 0.0)).apply(each.outline),
        )
        for each, at in places
    ]
    image = synthetic().image(sheets)
    detector = MarkerDetector(VISION.dictionary_number, CAMERA)
    for _ in range(3):
        found = detector.find(image)
        assert found.duplicates == (0,)
        assert 0 not in found.ids
        assert len(found.ids) == len(wall.corners) - 1


def test_a_calibration_that_the_image_contradicts_gives_a_warning_or_no_pose():
    """Seen from near and at a slant: a board far in front hides it."""
    wrong = Camera(
        1280, 720, CAMERA.matrix, np.array([0.4, 0.0, 0.0, 0.0, 0.0])
    )
    assert "reprojection error" in reason(
        localizer(camera=wrong), image_from_torso(BASE)
    )
    image = image_from_torso(
        Transform.of((0.6, -0.1, 0.07), (0.06, -0.05, 0.2))
    )
    matrix = CAMERA.matrix + np.array([[0.0, 0.0, 40.0], [0.0] * 3, [0.0] * 3])
    near = Camera(1280, 720, matrix, CAMERA.distortion)
    fix = localizer(camera=near).locate(5, image)
    assert isinstance(fix, MarkerFix)
    assert "usually below 0.6 px: wrong calibration" in fix.warning
    assert localizer().locate(5, image).warning == ""


def test_a_image_of_another_size_is_refused():
    with pytest.raises(CameraError, match=r"image of 640 x 360 px.*1280 x 720"):
        localizer().locate(0, BLANK[:360, :640])


def test_one_far_marker_alone_has_no_pose_unless_the_last_one_decides():
    far = {
        "boards.wall.columns": 1,
        "boards.wall.rows": 1,
        "boards.wall.marker": 0.04,
    }
    settings, base = (
        changed(**far),
        Transform.of((0.0, 0.0, 0.2), (0.0, 0.0, 0.0)),
    )
    located, single = (
        localizer(settings=settings),
        image_from_torso(base, settings=settings),
    )
    assert "two poses explain them" in reason(located, single)
    # So does a pose of after a clock that was set back.
    located._last = 100 * SECOND, base, np.zeros((6, 6))
    assert "two poses explain them" in reason(located, single)
    located._last = 0, base, np.zeros((6, 6))
    fix = located.locate(SECOND // 30, single)
    assert isinstance(fix, MarkerFix)
    np.testing.assert_allclose(fix.position, base.position, atol=0.2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"chessboard.columns": 20, "chessboard.rows": 12},
            "chessboard: 120 markers, DICT_4X4_100",
        ),
        (
            {"dictionary": "DICT_9X9"},
            "dictionary = 'DICT_9X9': not one of cv2.aruco",
        ),
        ({"points.first_id": 60}, "boards.film: id 60 is also in points"),
        ({"points.first_id": 90}, "id 106: DICT_4X4_100 ends at 99"),
        ({"chessboard.marker": 0.027}, "not smaller than square"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(changes, message):
    with pytest.raises(config.ConfigError, match=message):
        changed(**changes)


def test_a_camera_without_a_board_to_see_is_refused():
    with pytest.raises(
        config.ConfigError, match="boards: none in the frame odom"
    ):
        localizer(dataclasses.replace(VISION, boards={}))
    hidden = {"scene.sensors.camera.boards": ("torso",)}
    with pytest.raises(
        config.ConfigError, match=r"boards: 'torso': expected .* \(wall, film\)"
    ):
        ClosedLoop("marker_camera", "walk", None, 0, changes=hidden)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {
            "scene.sensors.camera.carrier": "world",
            "scene.sensors.camera.boards": ("torso",),
        },
    ],
)
def test_the_robot_walks_in_closed_loop_through_its_images(changes):
    """Two strides, once motion has shown that IMU and odometry agree: within 3 mm and 30 mm/s."""
    loop = ClosedLoop("marker_camera", "walk", None, 0, changes=changes)
    errors, ticks = [], 64
    for tick in loop.run(ticks):
        true, state = loop.plant.robot, tick.estimate.state
        errors.append(
            [*(state[3:6] - true.position), *(state[9:12] - true.velocity)]
        )
    assert len(errors) == ticks
    rms = np.sqrt(np.mean(np.square(errors[24:]), axis=0))
    assert rms[:3].max() < 3e-3
    assert rms[3:].max() < 30e-3
    assert true.position[0] > 0.02


CALIBRATION = messages.camera_to_msg(1, CAMERA)


@pytest.fixture
def rig(tmp_path):
    made = Rig(tmp_path, only=["marker_localizer"], scene="marker_camera")
    yield made
    made.close()


def test_images_become_odometry_or_lost_odometry_or_say_why_not(rig):
    images = rig.publisher(Image, "/camera/image_raw", qos.IMAGE)
    calibration = rig.publisher(CameraInfo, "/camera/camera_info", qos.IMAGE)

    def show(grey, info):
        """Publish a calibration and an image; the image's message and the odometry since."""
        before = rig.now()
        calibration.publish(info)
        rig.run(0.01)
        message = messages.image_to_msg(ImageReading(rig.now(), grey))
        images.publish(message)
        rig.run(0.01)
        return message, rig.since("/odom", before)

    _, odometry = show(
        image_from_torso(BASE), CameraInfo(width=1280, height=720)
    )
    assert not odometry
    log = "\n".join(rig.logs["marker_localizer"])
    assert (
        "camera/camera_info refused: K[0] = 0: the camera is not calibrated"
        in log
    )
    assert "camera/image_raw refused: no calibration" in log

    image, (odometry,) = show(image_from_torso(BASE), CALIBRATION)
    assert odometry.header.stamp == image.header.stamp
    assert (odometry.header.frame_id, odometry.child_frame_id) == (
        "odom",
        "base_link",
    )
    _, position, quaternion, *_, variance = decode.odometry(odometry)
    np.testing.assert_allclose(position, BASE.position, atol=2e-3)
    assert abs(quaternion @ BASE.quaternion) == pytest.approx(1.0, abs=1e-5)
    assert 0 < variance[:6].min() < variance[:6].max() < 1e-5

    image, (odometry,) = show(np.full((720, 1280), 120, np.uint8), CALIBRATION)
    assert odometry.header.stamp == image.header.stamp
    _, _, quaternion, *_, variance = decode.odometry(odometry)
    assert not quaternion.any()
    assert set(variance) == {9999.0}
    assert "no marker of DICT_4X4_100" in rig.logs["marker_localizer"][-1]
