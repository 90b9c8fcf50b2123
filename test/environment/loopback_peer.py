"""Process for test_loopback.py: `ask` publishes questions over DDS until `answer` has replied."""

import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String

PERIOD = 0.02  # s between two questions
rclpy.init()
role = sys.argv[1]
node, heard = rclpy.create_node(role), []
told, other = (
    ("question", "answer") if role == "ask" else ("answer", "question")
)
publisher = node.create_publisher(String, told, 10)
node.create_subscription(String, other, heard.append, 10)
if role == "ask":
    node.create_timer(
        PERIOD, lambda: publisher.publish(String(data="are you there?"))
    )
with suppress(KeyboardInterrupt, ExternalShutdownException):
    while role == "answer" or not heard:
        rclpy.spin_once(node)
        if role == "answer" and heard:
            publisher.publish(String(data="yes"))
    print(heard[0].data)
rclpy.try_shutdown()
