"""The executor of the nodes serves all that rclpy's executor serves.

Processes of one node or several: no clock is changed.
"""

import subprocess
import sys
import threading
import time
from contextlib import suppress

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException
from std_msgs.msg import Int32
from std_srvs.srv import Trigger

from slot_nodes import inputs, qos, runtime
from slot_nodes.process.executor import DirectExecutor


@pytest.fixture
def node():
    """Node on the executor under test, in a separate context."""
    context = Context()
    rclpy.init(context=context)
    node = rclpy.create_node("under_test", context=context)
    # a node holds its executor weakly
    executor = DirectExecutor(context=context)
    executor.add_node(node)
    yield node
    node.destroy_node()
    context.try_shutdown()


def spin_until(node, condition):
    while not condition():
        node.executor.spin_once(timeout_sec=0.1)


def test_a_slow_reader_in_the_process_gets_the_newest_of_all_that_wait(node):
    seen, mailbox = [], node.executor._mailbox
    publisher = node.create_publisher(Int32, "numbers", qos.CONTROL)

    def read(message, number):
        seen.append(message.data)

    def pass_on(message):
        mailbox.put((read, True), message, number=1)

    node.create_subscription(Int32, "numbers", pass_on, qos.CONTROL)
    for number in range(20):
        publisher.publish(Int32(data=number))
    spin_until(node, lambda: 19 in seen)
    assert len(seen) < 20


def test_polled_messages_wake_the_node_only_while_they_are_awaited(node):
    """Else it waits its whole time beside a message; rclpy's executor may take it with others."""
    received = []
    polled = inputs.PassiveSubscriptions(node)
    polled.subscribe(
        Int32,
        "polled",
        lambda message: received.append(message.data),
        qos.CONTROL,
    )
    publisher = node.create_publisher(Int32, "polled", qos.CONTROL)

    def sleeps(number):
        publisher.publish(Int32(data=number))
        begin = time.monotonic()
        node.executor.spin_once(timeout_sec=0.05)
        return time.monotonic() - begin >= 0.05 and number not in received

    last = next(number for number in range(20) if sleeps(number))
    while last not in received:
        polled.take()
    polled.wake_on_message(True)
    publisher.publish(Int32(data=last + 1))
    spin_until(node, lambda: last + 1 in received)
    assert received == list(range(last + 2))


def test_service_is_answered_between_messages_and_timers(node):
    received, ticks = [], []
    publisher = node.create_publisher(Int32, "numbers", qos.CONTROL)
    node.create_subscription(Int32, "numbers", received.append, qos.CONTROL)
    runtime.wall_timer(
        node, 0.001, lambda: ticks.append(publisher.publish(Int32()))
    )

    def answer(_, response):
        response.success = bool(received and ticks)
        return response

    node.create_service(Trigger, "ask", answer)
    client = node.create_client(Trigger, "ask")
    spin_until(node, lambda: received and client.service_is_ready())
    future = client.call_async(Trigger.Request())
    spin_until(node, future.done)
    assert future.result().success


def test_callbacks_of_an_answer_are_called_at_once_and_not_with_the_next_answer(
    node,
):
    node.create_service(Trigger, "ask", lambda _, response: response)
    client, called = node.create_client(Trigger, "ask"), []
    spin_until(node, client.service_is_ready)
    future = client.call_async(Trigger.Request())
    for name in "ab":
        future.add_done_callback(lambda _, name=name: called.append(name))
    spin_until(node, future.done)
    node.executor.spin_once(timeout_sec=0.1)
    assert sorted(called) == ["a", "b"]


def test_timer_created_by_a_callback_is_served_and_a_destroyed_one_is_not(node):
    ticks = []

    def replace():
        node.destroy_timer(first)
        node.destroy_timer(second)
        runtime.wall_timer(node, 0.001, lambda: ticks.append("third"))

    first = runtime.wall_timer(node, 0.001, replace)
    second = runtime.wall_timer(node, 0.001, lambda: ticks.append("second"))
    spin_until(node, lambda: ticks.count("third") == 3)
    assert "second" not in ticks


def test_exception_of_a_callback_is_raised_by_spin(node):
    def fail():
        raise ZeroDivisionError

    runtime.wall_timer(node, 0.001, fail)
    with pytest.raises(ZeroDivisionError):
        spin_until(node, lambda: False)


@pytest.mark.parametrize("how", ["a timer", "another thread"])
def test_spin_ends_with_its_context(node, how):
    if how == "a timer":
        runtime.wall_timer(node, 0.001, node.context.try_shutdown)
    else:
        threading.Timer(0.2, node.context.try_shutdown).start()
    with suppress(ExternalShutdownException):
        node.executor.spin()
    assert not node.context.ok()


def test_a_signal_ends_the_wait_even_if_the_context_ends_later(node):
    """Handler of rclpy: first it triggers this guard condition, then it ends the contexts."""
    node.executor._sigint_gc.trigger()
    with pytest.raises(ExternalShutdownException):
        spin_until(node, lambda: False)
    assert node.context.ok()


def test_a_signal_ends_the_wait_even_if_rclpy_takes_it_while_it_serves(
    node, monkeypatch
):
    """Else a node that is served a request then waits for a message that never comes."""
    executor, times = node.executor, []

    def signalled_while_served():
        executor._sigint_gc.trigger()
        times.append(1)
        return len(times) == 1

    monkeypatch.setattr(executor, "_has_others", signalled_while_served)
    with pytest.raises(ExternalShutdownException):
        executor.spin_once(timeout_sec=0.0)
    assert node.context.ok()


FIXED_CLOCK = """
import sys
from rclpy.node import Node
from rclpy.parameter import Parameter
from slot_nodes import runtime
from slot_nodes.process.composed import ComposedNodes

def serve(made):
    for node in getattr(made, "nodes", [made]):
        answer = node.set_parameters_atomically([Parameter("use_sim_time", value=True)])
        print(node.get_name(), answer.successful, node.get_clock().ros_time_is_active)

composed = lambda: ComposedNodes(["gait_scheduler", "force_mapper"])
runtime.run(composed if "composed" in sys.argv else lambda: Node("alone"), serve)
"""


@pytest.mark.parametrize(
    ("how", "names"),
    [("alone", ["alone"]), ("composed", ["gait_scheduler", "force_mapper"])],
)
def test_the_clock_of_a_node_that_runs_cannot_be_changed(how, names):
    """By `ros2 param set`; rclpy itself would follow."""
    command = [sys.executable, "-c", FIXED_CLOCK, how]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.stdout.splitlines() == [
        f"{name} False False" for name in names
    ], ended.stderr
