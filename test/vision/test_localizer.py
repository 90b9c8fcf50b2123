"""Marker localisation: the torso's pose from rendered images, and images without one."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from views import (
    CAMERA,
    MOUNT,
    VISION,
    board,
    image_from_torso,
    image_from_world,
    synthetic,
)

from slot_core import config
from slot_core.clock import SECOND
from slot_core.config import ConfigError
from slot_core.geometry import Transform
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.vision.board import print_of, single_marker
from slot_core.vision.camera import Camera, CameraError
from slot_core.vision.detector import MarkerDetector
from slot_core.vision.localizer import MarkerFix, MarkerLocalizer, NoFix
from slot_core.vision.settings import VisionSettings
from slot_core.vision.synthetic_camera import Surface

BLANK = np.full((720, 1280), 120, np.uint8)
BASE = Transform.of((0.15, -0.03, 0.07), (0.06, -0.05, 0.08))


def localizer(carrier="torso", settings=VISION, camera=CAMERA):
    return MarkerLocalizer(settings, camera, MOUNT, carrier)


def changed(**changes):
    return config.replace(VISION, changes)


@pytest.mark.parametrize(
    ("carrier", "frame"), [("torso", "odom"), ("world", "base_link")]
)
def test_settings_without_a_board_to_see_are_refused(carrier, frame):
    with pytest.raises(ConfigError, match=f"boards: none in the frame {frame}"):
        localizer(carrier, dataclasses.replace(VISION, boards={}))


@pytest.mark.parametrize("carrier", ["torso", "world"])
def test_the_pose_is_that_of_the_torso_within_its_covariance(carrier):
    image = image_from_torso(BASE) if carrier == "torso" else image_from_world(BASE)
    fix = localizer(carrier).locate(5, image)
    assert isinstance(fix, MarkerFix)
    turn = (
        Rotation.from_quat(fix.quaternion) * Rotation.from_matrix(BASE.rotation).inv()
    )
    error = np.concatenate([fix.position - BASE.position, turn.as_rotvec()])
    assert np.abs(error[:3]).max() < 2e-3
    assert np.abs(error[3:]).max() < 5e-3
    assert error @ np.linalg.solve(fix.pose_covariance, error) < 30.0  # six values
    assert np.sqrt(np.diag(fix.pose_covariance)).max() < 6e-3


def test_velocity_and_rate_are_the_difference_of_two_poses():
    located, dt = localizer(), 0.033
    moved = Transform.of((0.155, -0.03, 0.07), (0.06, -0.05, 0.09))
    located.locate(0, image_from_torso(BASE))
    fix = located.locate(round(dt * SECOND), image_from_torso(moved))
    expected = moved.rotation.T @ (moved.position - BASE.position) / dt
    turn = Rotation.from_matrix(BASE.rotation.T @ moved.rotation).as_rotvec() / dt
    np.testing.assert_allclose(fix.velocity, expected, atol=0.03)
    np.testing.assert_allclose(fix.angular_velocity, turn, atol=0.06)
    late = VISION.detection.acceleration * dt / 2
    assert np.diag(fix.twist_covariance)[:3].min() > late**2


def test_without_a_former_pose_the_velocity_is_unknown():
    fix = localizer().locate(0, image_from_torso(BASE))
    assert np.diag(fix.twist_covariance).min() >= 1e6


def test_a_image_that_repeats_its_stamp_changes_nothing():
    first, repeating = localizer(), localizer()
    other = Transform.of((0.16, -0.03, 0.07), (0.06, -0.05, 0.08))
    images = image_from_torso(BASE), image_from_torso(other)
    for _ in range(5):
        repeating.locate(0, images[0])
    first.locate(0, images[0])
    a, b = (each.locate(33_000_000, images[1]) for each in (first, repeating))
    np.testing.assert_array_equal(
        np.concatenate(a.odometry[1:]), np.concatenate(b.odometry[1:])
    )


def reason(located, image, images=1):
    for number in range(images):
        fix = located.locate(number, image)
    assert isinstance(fix, NoFix)
    assert not fix.odometry[2].any()  # the quaternion of lost odometry
    return fix.reason


@pytest.mark.parametrize(
    ("made", "said"),
    [
        (lambda: BLANK, "no marker of DICT_4X4_100"),
        (lambda: image_from_torso(BASE, blur=14.0), "no marker"),  # beyond recognition
        (
            lambda: image_from_torso(BASE, settings=changed(dictionary="DICT_5X5_100")),
            "but 15 of DICT_5X5_1000",
        ),
    ],
)
def test_a_image_without_markers_of_the_dictionary_has_no_pose(made, said):
    assert said in reason(localizer(), made(), images=10)


def test_ids_seen_twice_are_not_used():
    shown = board("wall")
    sheet = print_of(shown, VISION.dictionary_number)
    sheets = [
        Surface(
            sheet, Transform.of((x, 0.0, 1.8), (np.pi, 0.0, 0.0)).apply(shown.outline)
        )
        for x in (-0.45, 0.45)
    ]
    image, seeing = synthetic().image(sheets), localizer()
    assert "seen more than once" in reason(seeing, image)


def test_an_id_seen_twice_is_not_used_while_only_a_part_of_the_image_is_searched():
    """The search around the other markers may hold one of the two only."""
    wall, single = board("wall"), single_marker(0, 0.05)  # id 0 is of the board too
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


def test_markers_that_no_board_has_are_named():
    image = image_from_torso(BASE)
    elsewhere = changed(**{"boards.wall.frame": "base_link"})
    assert "no marker of the boards, only ids 0, 1" in reason(
        localizer(settings=elsewhere), image
    )


def test_a_wrong_calibration_is_refused_by_its_reprojection_error():
    wrong = Camera(1280, 720, CAMERA.matrix, np.array([0.4, 0.0, 0.0, 0.0, 0.0]))
    assert "reprojection error" in reason(
        localizer(camera=wrong), image_from_torso(BASE)
    )


def off_camera(focal=1.0, centre=0.0, covariance=None):
    """A camera whose focal length is off by a factor, and its centre by so many pixels."""
    matrix = CAMERA.matrix.copy()
    matrix[[0, 1], [0, 1]] *= focal
    matrix[0, 2] += centre
    return Camera(1280, 720, matrix, CAMERA.distortion, covariance)


def test_a_calibration_that_the_image_contradicts_gives_a_warning():
    """Seen from near and at a slant: a board far in front hides it."""
    image = image_from_torso(Transform.of((0.6, -0.1, 0.07), (0.06, -0.05, 0.2)))
    fix = localizer(camera=off_camera(centre=40.0)).locate(5, image)
    assert isinstance(fix, MarkerFix)
    assert "usually below 0.6 px: wrong calibration" in fix.warning
    assert localizer().locate(5, image).warning == ""


def test_a_focal_length_that_no_image_contradicts_is_in_the_covariance():
    """Too long by 5 % it takes the board for 55 mm further away, with a usual error."""
    image, deviation = image_from_torso(BASE), 0.05 * CAMERA.focal
    covariance = np.diag([deviation**2, deviation**2, *np.full(7, 1e-12)])
    covariance[0, 1] = covariance[1, 0] = deviation**2
    fixes = [
        localizer(camera=off_camera(1.05, covariance=known)).locate(5, image)
        for known in (None, covariance)
    ]
    off = fixes[0].position - BASE.position
    assert 0.04 < np.linalg.norm(off) < 0.08
    assert fixes[0].warning == ""
    sure, unsure = (fix.pose_covariance[:3, :3] for fix in fixes)
    assert off @ np.linalg.solve(sure, off) > 1000.0
    assert off @ np.linalg.solve(unsure, off) < 9.0
    np.testing.assert_allclose(fixes[1].twist_covariance, fixes[0].twist_covariance)


def test_a_image_of_another_size_is_refused():
    with pytest.raises(CameraError, match=r"image of 640 x 360 px.*1280 x 720"):
        localizer().locate(0, BLANK[:360, :640])


FAR = Transform.of((0.0, 0.0, 0.2), (0.0, 0.0, 0.0))


@pytest.fixture
def alone():
    """A localizer that knows a single far marker, and its image."""
    far = {"boards.wall.columns": 1, "boards.wall.rows": 1, "boards.wall.marker": 0.04}
    settings = changed(**far)
    return localizer(settings=settings), image_from_torso(FAR, settings=settings)


def test_one_far_marker_alone_has_no_pose_unless_the_last_one_decides(alone):
    located, single = alone
    assert "two poses explain them" in reason(located, single)
    located._last = 0, FAR, np.zeros((6, 6))
    fix = located.locate(SECOND // 30, single)
    assert isinstance(fix, MarkerFix)
    np.testing.assert_allclose(fix.position, FAR.position, atol=0.2)


def test_a_pose_of_after_a_clock_that_was_set_back_decides_nothing(alone):
    located, single = alone
    located._last = 100 * SECOND, FAR, np.zeros((6, 6))
    assert "two poses explain them" in reason(located, single)


def test_the_covariance_of_the_velocity_is_in_the_axes_of_the_torso():
    turned = Transform.of((0.0, 0.0, 0.2), (0.0, 0.0, np.pi / 2))
    # along x of odom, which is -y of the torso
    unsure = np.diag([4.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    known = localizer()
    known._last = 0, turned, unsure
    *_, twist = known._twist(SECOND // 30, turned, unsure)
    late = known._twist(SECOND // 30, turned, -unsure)[2]
    spread = (twist - late) / 30**2
    np.testing.assert_allclose(np.diag(spread)[:2], [2.0, 8.0])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"chessboard.columns": 20, "chessboard.rows": 12},
            "chessboard: 120 markers, DICT_4X4_100",
        ),
        ({"dictionary": "DICT_9X9"}, "dictionary = 'DICT_9X9': not one of cv2.aruco"),
        ({"points.first_id": 60}, "boards.film: id 60 is also in points"),
        ({"points.first_id": 90}, "id 106: DICT_4X4_100 ends at 99"),
        ({"chessboard.marker": 0.027}, "not smaller than square"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(changes, message):
    assert isinstance(VISION, VisionSettings)
    with pytest.raises(ConfigError, match=message):
        changed(**changes)


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
    """Two strides: every image gives an estimate, within 3 mm and 30 mm/s of the truth."""
    loop = ClosedLoop("marker_camera", "walk", None, 0, changes=changes)
    errors, ticks = [], 48
    for tick in loop.run(ticks):
        true, state = loop.plant.robot, tick.estimate.state
        errors.append([*(state[3:6] - true.position), *(state[9:12] - true.velocity)])
    assert len(errors) == ticks
    rms = np.sqrt(np.mean(np.square(errors[15:]), axis=0))
    assert rms[:3].max() < 3e-3
    assert rms[3:].max() < 30e-3
    assert true.position[0] > 0.02


def test_a_board_that_the_camera_cannot_see_is_refused():
    with pytest.raises(
        ConfigError, match=r"boards: 'torso': expected .* \(wall, film\)"
    ):
        ClosedLoop(
            "marker_camera",
            "walk",
            None,
            0,
            changes={"scene.sensors.camera.boards": ("torso",)},
        )
