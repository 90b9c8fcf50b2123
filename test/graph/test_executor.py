"""The nodes' executor serves what rclpy's serves."""

import threading
from contextlib import suppress

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from slot_nodes import qos, runtime
from slot_nodes.executor import DirectExecutor

LIMIT = 200  # turns of the executor, of at most 0.1 s each


@pytest.fixture
def node():
    """A node on an executor under test, in a context of its own."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("under_test", context=context)
    executor = DirectExecutor(context=context)  # a node holds its executor weakly
    executor.add_node(node)
    yield node
    node.destroy_node()
    context.try_shutdown()


def spin_until(node, condition):
    for _ in range(LIMIT):
        if condition():
            return
        node.executor.spin_once(timeout_sec=0.1)
    raise AssertionError("waited in vain")


def test_messages_come_one_by_one_in_their_order(node):
    heard = []
    publisher = node.create_publisher(Int32, "numbers", qos.CONTROL)
    node.create_subscription(Int32, "numbers", lambda m: heard.append(m.data), qos.CONTROL)
    for number in range(20):
        publisher.publish(Int32(data=number))
    spin_until(node, lambda: len(heard) == 20)
    assert heard == list(range(20))


def test_a_service_is_answered_between_messages_and_timers(node):
    heard, ticks = [], []
    publisher = node.create_publisher(Int32, "numbers", qos.CONTROL)
    node.create_subscription(Int32, "numbers", heard.append, qos.CONTROL)
    runtime.wall_timer(node, 0.001, lambda: ticks.append(publisher.publish(Int32())))

    def answer(_, response):
        response.success = bool(heard and ticks)
        return response

    node.create_service(Trigger, "ask", answer)
    client = node.create_client(Trigger, "ask")
    spin_until(node, lambda: heard and client.service_is_ready())
    future = client.call_async(Trigger.Request())
    spin_until(node, future.done)
    assert future.result().success


def test_what_a_callback_creates_is_served_and_what_it_destroys_is_not(node):
    ticks = []

    def exchange():
        node.destroy_timer(first)
        node.destroy_timer(second)
        runtime.wall_timer(node, 0.001, lambda: ticks.append("third"))

    first = runtime.wall_timer(node, 0.001, exchange)
    second = runtime.wall_timer(node, 0.001, lambda: ticks.append("second"))
    spin_until(node, lambda: ticks.count("third") == 3)
    assert "second" not in ticks


def test_what_a_callback_raises_comes_through(node):
    def fail():
        raise ZeroDivisionError

    runtime.wall_timer(node, 0.001, fail)
    with pytest.raises(ZeroDivisionError):
        spin_until(node, lambda: False)


def test_it_ends_with_its_context(node):
    runtime.wall_timer(node, 0.001, node.context.try_shutdown)
    rclpy.spin(node, node.executor)
    assert not node.context.ok()


def test_a_shutdown_from_outside_ends_the_wait(node):
    threading.Timer(0.2, node.context.try_shutdown).start()
    with suppress(ExternalShutdownException):
        node.executor.spin()
    assert not node.context.ok()
