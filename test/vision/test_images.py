"""Images in messages and bags; without a camera nothing of OpenCV is loaded.

Corners and poses of markers against what was rendered; calibrations of cameras.
"""

import subprocess
import sys

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from scipy import stats
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import CameraInfo, Image
from views import CAMERA, VISION, board, image_from_torso, seen_from_torso

from slot_core.geometry import Transform
from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.record_settings import read_record_settings
from slot_core.vision.board import board_poses, nearest
from slot_core.vision.camera import (
    Camera,
    CameraError,
    camera_text,
    from_camera_info,
    read_camera,
)
from slot_core.vision.detector import MarkerDetector, grey_image
from slot_lab.film.images import FilmError, bag_camera, read_film


def image(pixels, encoding="mono8", **changes):
    """A message of an image, with fields changed."""
    message = Image()
    message.height, message.width = pixels.shape[:2]
    message.encoding, message.step = encoding, pixels[0].nbytes
    message.data = pixels.tobytes()
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def test_images_of_every_encoding_are_grey():
    colour = np.zeros((2, 3, 3), np.uint8)
    colour[..., 2] = 200  # red of BGR
    assert set(np.unique(grey_image(image(colour, "bgr8")))) == {60}
    assert set(np.unique(grey_image(image(colour, "rgb8")))) == {23}
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(grey_image(image(grey)), grey)
    np.testing.assert_array_equal(
        grey_image(image(np.pad(grey, ((0, 0), (0, 5))), width=4)), grey
    )


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"encoding": "yuv422"}, "encoding 'yuv422': expected one of mono8"),
        ({"height": 4}, "12 bytes in rows of 4: 4 x 4 px of mono8"),
        (
            {"width": 0, "step": 0, "data": b"", "encoding": "bgr8"},
            "0 bytes in rows of 0: 0 x 3",
        ),
        ({"step": 3}, "12 bytes in rows of 3"),
        ({"data": b"", "height": 0}, "0 bytes"),
    ],
)
def test_a_image_with_missing_bytes_is_refused(changes, reason):
    with pytest.raises(ValueError, match=reason):
        grey_image(image(np.zeros((3, 4), np.uint8), **changes))


def write_bag(path, images, k=CAMERA.matrix):
    """A bag with images as (stamp in ms, array)."""
    info = CameraInfo(height=720, width=1280, distortion_model="plumb_bob")
    info.d, info.k = CAMERA.distortion, k.ravel()
    entries = [(0, "/camera/camera_info", info)]
    for ms, pixels in images:
        message = image(pixels)
        message.header.stamp.nanosec = ms * 1_000_000
        entries.append((ms * 1_000_000, "/camera/image_raw", message))
    with BagWriter(path, read_record_settings()) as bag:
        for time, topic, message in entries:
            kind = f"sensor_msgs/msg/{type(message).__name__}"
            bag.write(topic, kind, time, serialize_message(message))
    return path


def test_a_bag_gives_its_images_with_stamps_and_camera(tmp_path):
    images = [(ms, np.full((2, 3), ms, np.uint8)) for ms in (10, 43, 76)]
    bag = write_bag(tmp_path / "bag", images)
    frames = list(read_film(bag))
    assert [f.time for f in frames] == pytest.approx([0.010, 0.043, 0.076])
    assert [f.grey[0, 0] for f in frames] == [10, 43, 76]
    assert bag_camera(bag, "/camera/image_raw").equals(CAMERA)
    bare = write_bag(tmp_path / "bare", [], k=np.zeros((3, 3)))
    with pytest.raises(FilmError, match="no topic /camera/image_raw"):
        list(read_film(bare))
    reason = r"camera_info: K\[0\] = 0: the camera is not calibrated"
    with pytest.raises(FilmError, match=reason):
        bag_camera(bare, "/camera/image_raw")


def test_without_a_camera_in_the_scene_opencv_is_not_loaded():
    program = """
import sys
from slot_core.simulation.closed_loop import make_localizer
from slot_core.simulation.sensors import make_camera
from slot_core.dynamics.scene import read_scene
camera = read_scene("flat").sensors.camera
assert make_localizer(camera) is None and make_camera(camera, None) is None
assert "cv2" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=120)


@pytest.mark.parametrize("blur", [0.0, 0.6, 1.5])
def test_corners_are_found_to_a_twentieth_of_a_pixel_whatever_the_blur(blur):
    base = Transform.of((0.1, 0.05, 0.07), (0.05, -0.04, 0.1))
    found = MarkerDetector(VISION.dictionary_number, CAMERA).find(
        image_from_torso(base, blur=blur)
    )
    wall = board("wall")
    assert set(found.ids) == set(wall.corners)
    true = seen_from_torso(base).apply(
        np.array([wall.corners[i] for i in found.ids])
    )
    error = CAMERA.focal * (found.rays - true[..., :2] / true[..., 2:])
    assert np.sqrt(np.mean(error**2)) < 0.05
    assert np.abs(error).max() < 0.2


def test_covariance_of_a_pose_is_that_of_its_errors():
    """Mean normalised error squared of six values over n draws, within its 99.9 % bounds."""
    rng, count, noise = np.random.default_rng(0), 200, 2e-4
    points = np.concatenate(list(board("wall").corners.values()))
    true = Transform.of((0.1, -0.05, 1.2), (np.pi + 0.2, 0.1, 0.3))
    seen = true.apply(points)
    total = 0.0
    for _ in range(count):
        rays = seen[:, :2] / seen[:, 2:] + noise * rng.normal(
            size=(len(points), 2)
        )
        pose = board_poses(points, rays, noise)
        turn = Rotation.from_matrix(
            pose.transform.rotation @ true.rotation.T
        ).as_rotvec()
        error = np.concatenate([pose.transform.position - true.position, turn])
        total += error @ np.linalg.solve(pose.covariance, error)
    low, high = stats.chi2.ppf([0.0005, 0.9995], 6 * count)
    assert low < total < high


def test_a_small_marker_has_two_poses_of_which_the_expected_one_is_chosen():
    corners = 0.02 * np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    seen = Transform.of((0.0, 0.0, 1.5), (np.pi + 0.4, 0.0, 0.0)).apply(corners)
    rays = seen[:, :2] / seen[:, 2:] + 2e-4 * np.random.default_rng(1).normal(
        size=(4, 2)
    )
    pose = board_poses(corners, rays, 1e-4)
    assert pose.ratio < VISION.detection.ambiguity
    for expected in (pose, pose.other):
        assert nearest(pose, expected.transform) is expected
    tilts = [each.transform.rotation[2, 1] for each in (pose, pose.other)]
    assert min(tilts) < -0.2 < 0.2 < max(tilts)


INFO = {
    "width": 1280,
    "height": 720,
    "model": "plumb_bob",
    "d": [0.0] * 5,
    "k": [900.0, 0, 640, 0, 900, 360, 0, 0, 1],
}


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"k": [0.0] * 9}, r"K\[0\] = 0: the camera is not calibrated"),
        ({"k": [1.0]}, "K has 1 values, expected 9"),
        ({"k": [float("nan"), *INFO["k"][1:]]}, "not finite"),
        ({"k": [-900.0, *INFO["k"][1:]]}, "expected > 0"),
        (
            {"model": "equidistant", "d": [0.0] * 4},
            "distortion_model 'equidistant': expected one",
        ),
        ({"d": [0.0] * 4}, "D has 4 values, plumb_bob has 5"),
        ({"d": [float("inf")] * 5}, "not finite"),
        (
            {"k": [900.0, 40.0, *INFO["k"][2:]]},
            r"K\[1\] = 40, .* without skew",
        ),
        (
            {"k": np.reshape(INFO["k"], (3, 3)).T},
            r"K\[6:9\] = 640, 360, 1: transposed\?, expected 0, 0, 1",
        ),
        (
            {"k": [0.7, 0, 0.5, 0, 1.3, 0.5, 0, 0, 1]},
            "f_x = 0.7 px, a field of view of 180 deg on 1280 px, .*normalised",
        ),
        ({"k": [9e5, *INFO["k"][1:]]}, "a field of view of 0.0815 deg"),
        (
            {"height": 300},
            r"c_y = 360 px: outside of the image, \[0, 300\]",
        ),
        (
            {"model": "equidistant", "d": []},
            "distortion_model 'equidistant': .* rectify the images of a fish",
        ),
        ({"k": [1e308, *INFO["k"][1:]]}, "above 1e\\+06"),
        ({"k": [10**400] * 9}, "K = .*: expected numbers"),
        ({"d": {"a": 1}}, "D = .*: expected numbers"),
        ({"model": ["plumb_bob"]}, "distortion_model .*: expected one"),
        *(
            ({name: size}, f"image_{name} = .*: expected an integer in")
            for name in ("width", "height")
            for size in (float("inf"), 10**400, True, 640.5, 0, -1, "640", None)
        ),
    ],
)
def test_an_unusable_camera_info_is_refused(changes, reason):
    with pytest.raises(CameraError, match=reason):
        from_camera_info(**(INFO | changes))


def known(values):
    """Text of a calibration with a covariance."""
    return camera_text(CAMERA) + f"intrinsics_covariance: {{data: {values}}}"


@pytest.mark.parametrize("size", [5, 8])
def test_a_calibration_file_gives_the_same_camera_back(tmp_path, size):
    for covariance in (None, np.diag(np.linspace(0.5, 1e-3, 4 + size))):
        camera = Camera(
            640,
            360,
            np.diag([0.5, 0.5, 1.0]) @ CAMERA.matrix,
            np.linspace(-0.01, 0.02, size),
            covariance,
        )
        (tmp_path / "camera.yaml").write_text(camera_text(camera))
        found = read_camera(tmp_path / "camera.yaml")
        assert found.equals(camera)
        np.testing.assert_array_equal(found.covariance, covariance)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "not subscriptable"),
        ("image_width: 3", "image_height is missing"),
        ("[", "expected the node content|while parsing"),
        ("%YAML:1.0\n---\nK: !!opencv-matrix\n", "a file of OpenCV"),
        ("version https://git-lfs.github.com/spec", "a pointer of Git LFS"),
        (known([1.0] * 3), "intrinsics_covariance has 3 values, expected 81"),
        (known(np.tri(9).ravel().tolist()), "not symmetric and positive"),
        (known((-np.eye(9)).ravel().tolist()), "not symmetric and positive"),
        (known([float("nan")] * 81), "a value that is not finite"),
    ],
)
def test_a_file_that_is_no_calibration_is_refused_in_one_line(
    tmp_path, text, reason
):
    file = tmp_path / "camera.yaml"
    file.write_text(text)
    for path, said in ((file, reason), (tmp_path / "no.yaml", "No such file")):
        with pytest.raises(CameraError, match=said) as refused:
            read_camera(path)
        assert "\n" not in str(refused.value)


@pytest.mark.parametrize("size", [5, 8])
def test_the_calibration_moves_a_pose_by_its_covariance(size):
    """The same pixels through cameras that are off by the columns of its root."""
    points = np.concatenate(list(board("wall").corners.values()))
    distortion = np.zeros(size)
    distortion[:5] = CAMERA.distortion
    deviation = np.array([2.0, 1.5, 1.0, 0.8, *np.full(size, 2e-3)])
    root = 0.3 * np.diag(deviation) @ np.tri(4 + size) / np.sqrt(4 + size)

    def camera(off):
        (f_x, f_y, c_x, c_y), coefficients = np.split(off, [4])
        matrix = CAMERA.matrix + np.array(
            [[f_x, 0, c_x], [0, f_y, c_y], [0, 0, 0]]
        )
        return Camera(
            1280, 720, matrix, distortion + coefficients, root @ root.T
        )

    true = camera(np.zeros(4 + size))
    pixels = true.project(
        Transform.of((0.1, -0.05, 1.2), (np.pi + 0.2, 0.1, 0.3)).apply(points)
    )
    exact = board_poses(points, true.rays(pixels), 1e-4, true)
    moved = []
    for off in root.T:
        found = board_poses(points, camera(off).rays(pixels), 1e-4).transform
        turn = Rotation.from_matrix(
            found.rotation @ exact.transform.rotation.T
        ).as_rotvec()
        moved.append(
            np.concatenate([found.position - exact.transform.position, turn])
        )
    expected = np.transpose(moved) @ moved
    np.testing.assert_allclose(
        exact.calibration, expected, atol=0.03 * np.abs(expected).max()
    )
    assert np.sqrt(exact.calibration[2, 2]) > 1e-4  # m: of the distance
    assert not board_poses(points, true.rays(pixels), 1e-4).calibration.any()
