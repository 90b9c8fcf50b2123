"""The node marker_localizer: images and calibration in, odometry or lost odometry out."""

import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image
from simulated_rig import SimulatedRig
from views import CAMERA, image_from_torso

from slot_core.geometry import Transform
from slot_core.messages import decode
from slot_core.simulation.readings import ImageReading
from slot_nodes import messages, qos

BASE = Transform.of((0.15, -0.03, 0.07), (0.06, -0.05, 0.08))
BLANK = np.full((720, 1280), 120, np.uint8)
CALIBRATION = messages.camera_to_msg(1, CAMERA)


@pytest.fixture
def rig(tmp_path):
    made = SimulatedRig(tmp_path, only=["marker_localizer"], scene="marker_camera")
    yield made
    made.close()


@pytest.fixture
def show(rig):
    """A function that publishes a calibration and an image and returns the odometry since."""
    image = rig.publisher(Image, "/camera/image_raw", qos.IMAGE)
    calibration = rig.publisher(CameraInfo, "/camera/camera_info", qos.IMAGE)

    def publish(grey, info=CALIBRATION):
        before = rig.now()
        calibration.publish(info)
        rig.run(0.01)
        message = messages.image_to_msg(ImageReading(rig.now(), grey))
        image.publish(message)
        rig.run(0.01)
        return message, rig.since("/odom", before)

    return publish


def test_without_a_calibration_there_is_no_odometry_and_it_says_why(rig, show):
    _, odometry = show(image_from_torso(BASE), CameraInfo(width=1280, height=720))
    assert not odometry
    log = "\n".join(rig.log_lines("marker_localizer"))
    assert "camera/camera_info refused: K[0] = 0: the camera is not calibrated" in log
    assert "camera/image_raw refused: no calibration" in log


def test_a_image_of_the_board_is_an_odometry_with_its_stamp_and_covariance(show):
    image, (odometry,) = show(image_from_torso(BASE))
    assert odometry.header.stamp == image.header.stamp
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("odom", "base_link")
    _, position, quaternion, *_, variance = decode.odometry(odometry)
    np.testing.assert_allclose(position, BASE.position, atol=2e-3)
    assert abs(quaternion @ BASE.quaternion) == pytest.approx(1.0, abs=1e-5)
    assert 0 < variance[:6].min() < variance[:6].max() < 1e-5


def test_a_image_without_a_pose_is_a_lost_odometry_that_says_why(rig, show):
    image, (odometry,) = show(BLANK)
    assert odometry.header.stamp == image.header.stamp
    _, _, quaternion, *_, variance = decode.odometry(odometry)
    assert not quaternion.any()
    assert set(variance) == {9999.0}
    assert "no marker of DICT_4X4_100" in rig.log_lines("marker_localizer")[-1]


def test_a_image_of_another_size_is_refused(rig, show):
    _, odometry = show(BLANK[:360])
    assert not odometry
    assert "image of 1280 x 360 px" in rig.log_lines("marker_localizer")[-1]
