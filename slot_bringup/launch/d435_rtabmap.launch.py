"""RealSense D435i, RTAB-Map's visual odometry and the graph, with real servos.

ros2 launch slot_bringup d435_rtabmap.launch.py gait:=walk

Needs ros-jazzy-realsense2-camera and ros-jazzy-rtabmap-launch. Takes the arguments of
slot.launch.py. Written after the published launch files of realsense2_camera and rtabmap_launch;
it was not run with a camera.
"""

from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, GroupAction, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch_ros.actions import SetParameter

CAMERA = {
    "camera_namespace": "",  # topics /camera/color/image_raw ...
    "rgb_camera.color_profile": "640,480,30",
    "depth_module.depth_profile": "640,480,30",
    "align_depth.enable": "true",
    "enable_sync": "true",
    "enable_gyro": "true",
    "enable_accel": "true",
    "unite_imu_method": "2",  # linear interpolation: one /camera/imu at the gyroscope's rate
}
RTABMAP = {
    "namespace": "rtabmap",
    "frame_id": "base_link",
    "rgb_topic": "/camera/color/image_raw",
    "depth_topic": "/camera/aligned_depth_to_color/image_raw",
    "camera_info_topic": "/camera/color/camera_info",
    "odom_topic": "odom",  # /rtabmap/odom
    "vo_frame_id": "odom",
    "publish_tf_odom": "false",  # state_estimator publishes odom -> base_link
    "approx_sync": "false",
    "rtabmap_viz": "false",
}
EMITTER = SetParameter(name="depth_module.emitter_enabled", value=1)
SLOT = {"hardware": "real", "odometry_topic": "/rtabmap/odom", "imu_topic": "/camera/imu"}


def generate_launch_description() -> LaunchDescription:
    """Start the camera, the odometry and the graph."""
    return LaunchDescription(
        [
            *(DeclareLaunchArgument(name, default_value=value) for name, value in SLOT.items()),
            _include("realsense2_camera", "rs_launch.py", CAMERA, EMITTER),
            _include("rtabmap_launch", "rtabmap.launch.py", RTABMAP),
            _include("slot_bringup", "slot.launch.py", {}),
        ]
    )


def _include(package: str, file: str, arguments: dict[str, str], *before: Any) -> GroupAction:
    """Include a launch file in a scope of its own: namespace and others are named in several."""
    source = str(Path(get_package_share_directory(package), "launch", file))
    launch_file = PythonLaunchDescriptionSource(source)
    given = list(arguments.items())
    return GroupAction([*before, IncludeLaunchDescription(launch_file, launch_arguments=given)])
