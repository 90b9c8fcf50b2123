"""Images in messages and bags; without a camera nothing of OpenCV is loaded."""

import subprocess
import sys

import numpy as np
import pytest
from synthetic_walk import TYPES, blank
from views import CAMERA

from slot_core.recording.bag_writer import BagWriter
from slot_core.recording.record_settings import read_record_settings
from slot_core.vision import image_message
from slot_lab.film.images import FilmError, bag_camera, read_film


def image(pixels, encoding="mono8", **changes):
    """A message of an image, with fields changed."""
    message = blank("sensor_msgs/msg/Image")
    message.height, message.width = pixels.shape[:2]
    message.encoding, message.step = encoding, pixels[0].nbytes
    message.data = np.frombuffer(pixels.tobytes(), np.uint8)
    for name, value in changes.items():
        setattr(message, name, value)
    return message


def test_images_of_every_encoding_are_grey_and_depth_is_in_millimetres():
    colour = np.zeros((2, 3, 3), np.uint8)
    colour[..., 2] = 200  # red of BGR
    assert set(np.unique(image_message.grey(image(colour, "bgr8")))) == {60}
    assert set(np.unique(image_message.grey(image(colour, "rgb8")))) == {23}
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(image_message.grey(image(grey)), grey)
    np.testing.assert_array_equal(
        image_message.grey(image(np.pad(grey, ((0, 0), (0, 5))), width=4)), grey
    )
    depth = np.array([[800, 1], [2, 65535]], np.uint16)
    for big, order in ((0, "<u2"), (1, ">u2")):
        message = image(depth.astype(order), "16UC1", is_bigendian=big)
        np.testing.assert_array_equal(image_message.depth(message), depth)


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
        image_message.grey(image(np.zeros((3, 4), np.uint8), **changes))


def write_bag(path, images, depths=(), k=CAMERA.matrix):
    """A bag with images and depth images as (stamp in ms, array)."""
    info = blank("sensor_msgs/msg/CameraInfo")
    info.height, info.width, info.distortion_model = 720, 1280, "plumb_bob"
    info.d, info.k = CAMERA.distortion, k.ravel()
    entries = [(0, "/camera/camera_info", info)]
    for topic, encoding, frames in (
        ("/camera/image_raw", "mono8", images),
        ("/camera/depth", "16UC1", depths),
    ):
        for ms, pixels in frames:
            message = image(pixels, encoding)
            message.header.stamp.nanosec = ms * 1_000_000
            entries.append((ms * 1_000_000, topic, message))
    with BagWriter(path, read_record_settings()) as bag:
        for time, topic, message in entries:
            kind = message.__msgtype__
            bag.write(topic, kind, time, TYPES.serialize_cdr(message, kind))
    return path


def test_a_bag_gives_its_images_with_stamps_camera_and_the_nearest_depth(
    tmp_path,
):
    images = [(ms, np.full((2, 3), ms, np.uint8)) for ms in (10, 43, 76)]
    depths = [(ms, np.full((2, 3), ms, np.uint16)) for ms in (12, 40, 100)]
    bag = write_bag(tmp_path / "bag", images, depths)
    frames = list(read_film(bag, depth="/camera/depth"))
    assert [f.time for f in frames] == pytest.approx([0.010, 0.043, 0.076])
    assert [f.grey[0, 0] for f in frames] == [10, 43, 76]
    assert [f.depth is not None and f.depth[0, 0] for f in frames] == [
        12,
        40,
        False,
    ]
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
