"""`/camera/image_raw` and `/camera/camera_info` to `/odom`: the torso's pose from markers.

The parameter `carrier` says what the camera stands on. An image without a usable pose gives an
odometry that says it is lost, as RTAB-Map does: a quaternion of zeros and a covariance of 9999.
"""

from pathlib import Path

import cv2
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import CameraInfo, Image

from slot_core.clock import to_seconds
from slot_core.config import ConfigError
from slot_core.estimation.state_estimator import read_estimator
from slot_core.geometry import Transform
from slot_core.messages import decode
from slot_core.vision.camera import (
    Camera,
    CameraError,
    from_camera_info,
    read_camera,
)
from slot_core.vision.detector import grey_image
from slot_core.vision.localizer import MarkerFix, MarkerLocalizer
from slot_core.vision.settings import read_vision
from slot_nodes import inputs, messages, qos, runtime


class MarkerLocalizerNode(Node):
    """Localises the torso in every image once the camera's calibration is known."""

    def __init__(self) -> None:
        super().__init__("marker_localizer")
        cv2.setNumThreads(1)  # the other nodes need the cores
        self._settings = runtime.declare_settings(self, read_vision())
        mount = read_estimator().mounts.camera
        self._mount = Transform.of(mount.position, mount.rpy)
        file = runtime.declare(
            self,
            "calibration",
            "",
            "file of scripts/calibrate --camera; empty: /camera/camera_info",
        )
        self._localizer: MarkerLocalizer | None = None
        self._camera: Camera | None = None
        self._odometry = runtime.publisher(self, Odometry, "odom", qos.SENSOR)
        profile = inputs.sensor_profile(self, qos.IMAGE)
        if file:
            try:
                self._use(read_camera(Path(file)))
            except CameraError as error:
                raise ConfigError(
                    f"marker_localizer: calibration {error}"
                ) from None
        else:
            inputs.subscribe(
                self, CameraInfo, "camera/camera_info", self._on_info, profile
            )
        inputs.subscribe(
            self, Image, "camera/image_raw", self._on_image, profile
        )

    def _on_info(self, message: CameraInfo) -> None:
        """Take the calibration, and a new one if it changes."""
        camera = from_camera_info(
            message.width,
            message.height,
            message.distortion_model,
            message.d,
            message.k,
        )
        if self._camera is None or not camera.equals(self._camera):
            self._use(camera)

    def _use(self, camera: Camera) -> None:
        self._localizer = MarkerLocalizer(self._settings, camera, self._mount)
        self._camera = camera
        known = (
            ""
            if camera.covariance is not None
            else ", its calibration taken as exact"
        )
        self.get_logger().info(
            f"camera of {camera.width} x {camera.height} px, f = {camera.focal:.1f} px,"
            f" on the {self._settings.carrier}{known}"
        )

    def _on_image(self, message: Image) -> None:
        if self._localizer is None:
            raise ValueError(
                "no calibration: no usable /camera/camera_info has arrived"
            )
        fix = self._localizer.locate(decode.stamp(message), grey_image(message))
        if isinstance(fix, MarkerFix):
            self._odometry.publish(messages.fix_to_odometry(fix))
            reason = fix.warning
        else:
            self._odometry.publish(messages.lost_odometry(fix))
            reason = fix.reason
        if reason:
            self.get_logger().warning(
                f"image at {to_seconds(fix.stamp):.3f} s: {reason}",
                throttle_duration_sec=1.0,
            )
