"""A sensor of its own process: passes /simulated/TOPIC on to /TOPIC, best effort as drivers do.

usage: python relay.py odom | imu
"""

import contextlib
import sys

import rclpy
from nav_msgs.msg import Odometry
from rclpy.executors import ExternalShutdownException
from sensor_msgs.msg import Imu

from slot_nodes import qos

KINDS = {"odom": Odometry, "imu": Imu}


def main(topic):
    """Pass messages on until the process is ended."""
    rclpy.init()
    node = rclpy.create_node(f"{topic}_driver")
    publisher = node.create_publisher(
        KINDS[topic], topic, qos.best_effort(qos.SENSOR)
    )
    node.create_subscription(
        KINDS[topic], f"simulated/{topic}", publisher.publish, qos.SENSOR
    )
    with contextlib.suppress(ExternalShutdownException, KeyboardInterrupt):
        rclpy.spin(node)


if __name__ == "__main__":
    main(sys.argv[1])
