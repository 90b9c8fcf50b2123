"""RealSense D435i, Isaac ROS Visual SLAM and the graph, with real servos.

ros2 launch slot_bringup d435_isaac_vslam.launch.py gait:=walk

Needs realsense2_camera and isaac_ros_visual_slam 4.x on a Jetson or an NVIDIA GPU. Takes the
arguments of slot.launch.py. The SLAM is started as in its own launch file for RealSense, which has
no arguments and publishes odom -> camera_link; here it is base_link, without that transform.
Written after the published parameters and topics; it was not run with a camera.

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
from launch_ros.actions import ComposableNodeContainer, SetParameter
from launch_ros.descriptions import ComposableNode
from launch_ros.substitutions import FindPackageShare

CAMERA = {
    "camera_namespace": "",  # topics /camera/infra1/image_rect_raw ...
    "enable_infra1": "true",
    "enable_infra2": "true",
    "enable_color": "false",
    "enable_depth": "false",
    "depth_module.infra_profile": "640,360,60",
    "enable_gyro": "true",
    "enable_accel": "true",
    "gyro_fps": "200",
    "accel_fps": "250",  # of a D435i
    "unite_imu_method": "2",  # linear interpolation: one /camera/imu at the gyroscope's rate
}
VISUAL_SLAM = {
    "num_cameras": 2,
    "rectified_images": True,
    "tracking_mode": 1,  # with the IMU
    "gyro_noise_density": 0.000244,  # this and the next from its launch file
    "gyro_random_walk": 0.000019393,
    "accel_noise_density": 0.001862,
    "accel_random_walk": 0.003,
    "calibration_frequency": 200.0,
    "image_jitter_threshold_ms": 19.0,
    "base_frame": "base_link",
    "imu_frame": "camera_gyro_optical_frame",
    "camera_optical_frames": [
        "camera_infra1_optical_frame",
        "camera_infra2_optical_frame",
    ],
    "publish_odom_to_base_tf": False,  # state_estimator publishes it
}
TOPICS = {
    "visual_slam/image_0": "/camera/infra1/image_rect_raw",
    "visual_slam/camera_info_0": "/camera/infra1/camera_info",
    "visual_slam/image_1": "/camera/infra2/image_rect_raw",
    "visual_slam/camera_info_1": "/camera/infra2/camera_info",
    "visual_slam/imu": "/camera/imu",
}
# its dots move along
EMITTER = SetParameter(name="depth_module.emitter_enabled", value=0)
SLOT = {
    "hardware": "real",
    "odometry_topic": "/visual_slam/tracking/odometry",
    "imu_topic": "/camera/imu",
}


def generate_launch_description() -> LaunchDescription:
    """Start the camera, the SLAM and the graph."""
    visual_slam = ComposableNode(
        name="visual_slam_node",
        package="isaac_ros_visual_slam",
        plugin="nvidia::isaac_ros::visual_slam::VisualSlamNode",
        parameters=[VISUAL_SLAM],
        remappings=list(TOPICS.items()),
    )
    return LaunchDescription(
        [
            *(
                DeclareLaunchArgument(name, default_value=value)
                for name, value in SLOT.items()
            ),
            _include(
                # looked up when the launch starts
                PathJoinSubstitution(
                    [
                        FindPackageShare("realsense2_camera"),
                        "launch",
                        "rs_launch.py",
                    ]
                ),
                CAMERA,
                EMITTER,
            ),
            ComposableNodeContainer(
                name="visual_slam_launch_container",
                namespace="",
                package="rclcpp_components",
                executable="component_container",
                composable_node_descriptions=[visual_slam],
                output="screen",
            ),
            _include(str(Path(__file__).with_name("slot.launch.py")), {}),
        ]
    )


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
