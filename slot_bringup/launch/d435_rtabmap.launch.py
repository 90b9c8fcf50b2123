"""RealSense D435i, RTAB-Map's visual odometry and the graph, with real servos.

ros2 launch slot_bringup d435_rtabmap.launch.py gait:=walk

Needs ros-jazzy-realsense2-camera and ros-jazzy-rtabmap-launch. Takes the arguments of
slot.launch.py. Written after the published launch files of realsense2_camera and rtabmap_launch;
it was not run with a camera.

The origin of odom is where base_link was at the first image. It need not be the floor: the state
estimator learns the floor's place while the robot lies with slack tendons, and as it stands up.
"""

from pathlib import Path
from typing import Any

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import PathJoinSubstitution
from launch_ros.actions import SetParameter
from launch_ros.substitutions import FindPackageShare

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
SLOT = {
    "hardware": "real",
    "odometry_topic": "/rtabmap/odom",
    "imu_topic": "/camera/imu",
}


def generate_launch_description() -> LaunchDescription:
    """Start the camera, the odometry and the graph."""
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value)
                for name, value in SLOT.items()
            ),
            _include(
                _launch_file("realsense2_camera", "rs_launch.py"),
                CAMERA,
                EMITTER,
            ),
            _include(
                _launch_file("rtabmap_launch", "rtabmap.launch.py"), RTABMAP
            ),
            _include(str(Path(__file__).with_name("slot.launch.py")), {}),
        ]
    )


def _launch_file(package: str, name: str) -> PathJoinSubstitution:
    """Launch file of a package, which is looked up when the launch starts."""
    return PathJoinSubstitution([FindPackageShare(package), "launch", name])


def _include(
    source: Any, arguments: dict[str, str], *before: Any
) -> GroupAction:
    """Include a launch file in a new scope, as several have arguments such as namespace."""
    return GroupAction(
        [
            *before,
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(source),
                launch_arguments=list(arguments.items()),
            ),
        ]
    )
