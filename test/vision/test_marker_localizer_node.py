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
CALIBRATION = messages.camera_to_msg(1, CAMERA)


@pytest.fixture
def rig(tmp_path):
    made = SimulatedRig(
        tmp_path, only=["marker_localizer"], scene="marker_camera"
    )
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
    log = "\n".join(rig.log_lines("marker_localizer"))
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
    assert "no marker of DICT_4X4_100" in rig.log_lines("marker_localizer")[-1]
