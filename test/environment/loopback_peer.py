"""Process for test_loopback.py: `ask` publishes questions over DDS until `answer` has replied."""

import sys
from contextlib import suppress

import rclpy
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import String

PERIOD = 0.02  # s between two questions


def ask() -> None:
    node = rclpy.create_node("ask")
    answers: list[str] = []
    node.create_subscription(
        String, "answer", lambda message: answers.append(message.data), 10
    )
    questions = node.create_publisher(String, "question", 10)
    node.create_timer(PERIOD, lambda: questions.publish(String(data="are you there?")))
    while not answers:
        rclpy.spin_once(node)
    print(answers[0])


def answer() -> None:
    node = rclpy.create_node("answer")
    answers = node.create_publisher(String, "answer", 10)
    node.create_subscription(
        String, "question", lambda _: answers.publish(String(data="yes")), 10
    )
    rclpy.spin(node)


if __name__ == "__main__":
    rclpy.init()
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        {"ask": ask, "answer": answer}[sys.argv[1]]()
    rclpy.try_shutdown()
