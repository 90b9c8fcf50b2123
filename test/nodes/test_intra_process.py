"""Messages between nodes of one process."""

from functools import partial
from unittest.mock import Mock

import pytest
from rclpy.qos import QoSProfile

from slot_core.messages import decode
from slot_core.messages.carried import Carried
from slot_core.recording.record_settings import BagError
from slot_msgs.msg import RobotState
from slot_nodes import qos
from slot_nodes.process import intra_process
from slot_nodes.recorder_node import RecorderNode

EVERY, NEWEST = QoSProfile(depth=50), QoSProfile(depth=1)


class Recorded:
    """Publisher that keeps what it publishes, in a list shared with the readers."""

    topic_name = "/numbers"

    def __init__(self, events, profile=EVERY):
        self.events, self.qos_profile = events, profile
        self.subscribers = 0

    def get_subscription_count(self):
        return self.subscribers

    def publish(self, message):
        self.events.append(("topic", message))


@pytest.fixture
def mailbox():
    return intra_process.Mailbox()


@pytest.fixture
def events():
    return []


def reader(events, name):
    return lambda message, number: events.append((name, message, number))


def test_nodes_of_the_process_receive_a_message_before_its_topic_does(
    mailbox, events
):
    with mailbox.in_use():
        numbers = intra_process.publisher(Recorded(events))
        assert intra_process.subscribe("/numbers", reader(events, "a"), EVERY)
        assert intra_process.subscribe("/numbers", reader(events, "b"), EVERY)
    message = object()
    numbers.publish(message)
    assert mailbox.waiting
    assert events == []
    mailbox.deliver()
    assert events == [("a", message, 1), ("b", message, 1), ("topic", message)]
    assert events[0][1] is message
    assert not mailbox.waiting


def test_a_topic_that_no_node_of_the_process_publishes_is_left_to_dds(
    mailbox, events
):
    with mailbox.in_use():
        assert not intra_process.subscribe("/odom", reader(events, "a"), EVERY)
    assert not intra_process.subscribe("/numbers", reader(events, "a"), EVERY)
    intra_process.publisher(Recorded(events)).publish(1)
    assert events == [("topic", 1)]


def test_a_slow_reader_of_the_newest_skips_the_others_and_sees_their_number(
    mailbox, events
):
    with mailbox.in_use():
        numbers = intra_process.publisher(Recorded(events))
        intra_process.subscribe("/numbers", reader(events, "every"), EVERY)
        intra_process.subscribe("/numbers", reader(events, "newest"), NEWEST)
    for value in "abc":
        numbers.publish(value)
    mailbox.deliver()
    assert events[:3] == [
        ("every", value, n) for n, value in enumerate("abc", 1)
    ]
    assert events[3:] == [
        ("newest", "c", 3),
        *(("topic", value) for value in "abc"),
    ]


def test_an_answer_to_a_message_is_delivered_in_the_same_round(mailbox, events):
    """The command of a tick is there before the messages that led to it are published."""
    with mailbox.in_use():
        numbers = intra_process.publisher(Recorded(events))
        answers = intra_process.publisher(
            type("", (Recorded,), {"topic_name": "/answers"})(events)
        )
        intra_process.subscribe(
            "/numbers", lambda m, _: answers.publish(-m), NEWEST
        )
        intra_process.subscribe("/answers", reader(events, "answer"), EVERY)
    numbers.publish(7)
    mailbox.deliver()
    assert events == [("answer", -7, 1), ("topic", 7), ("topic", -7)]


def test_what_is_put_off_waits_for_the_answers_and_is_done_at_once_by_a_lone_node(
    mailbox, events
):
    with mailbox.in_use():
        numbers = intra_process.publisher(Recorded(events))
        intra_process.subscribe("/numbers", reader(events, "a"), NEWEST)
        later = intra_process.afterwards()
    numbers.publish(1)
    later(lambda: events.append("later"))
    mailbox.deliver()
    assert events == [("a", 1, 1), ("topic", 1), "later"]
    intra_process.afterwards()(events.clear)
    assert events == []


def test_a_reader_made_before_the_publisher_leaves_its_subscription_by_dds(
    mailbox, events
):
    """Robot and controller read each other's topics, so one of them is made first."""
    with mailbox.in_use():
        assert not intra_process.subscribe(
            "/numbers", reader(events, "a"), EVERY
        )
        intra_process.subscribe_later(
            "/numbers",
            reader(events, "a"),
            EVERY,
            lambda: events.append("unsubscribed"),
        )
        assert events == []
        numbers = intra_process.publisher(Recorded(events))
    assert events == ["unsubscribed"]
    numbers.publish(1)
    mailbox.deliver()
    assert events[1:] == [("a", 1, 1), ("topic", 1)]


def test_a_recorder_has_all_messages_of_the_process_once_and_not_by_dds(
    mailbox, events
):
    """Several nodes may publish a topic; without a subscriber nothing goes out."""
    with mailbox.in_use():
        intra_process.record(
            "/numbers",
            lambda m: events.append(("bag", m.value)),
            lambda: events.append("unsubscribed"),
        )
        publishers = [
            intra_process.publisher(Recorded(events)) for _ in range(2)
        ]
    for number, numbers in enumerate(publishers):
        numbers.publish(carried([], number))
    mailbox.deliver()
    assert events == ["unsubscribed", ("bag", 0), ("bag", 1)]


def test_a_full_disk_ends_the_process_and_is_no_refusal_of_a_message():
    """A node publishes while it takes a message: a ValueError would only drop that one."""
    recorder = Mock(_write=Mock(side_effect=BagError("full")))
    recorder._ended_by_the_disk = partial(
        RecorderNode._ended_by_the_disk, recorder
    )
    with pytest.raises(SystemExit) as ended:
        RecorderNode._write_message(recorder, "/robot_state", RobotState())
    assert ended.value.code == 1
    recorder.get_logger().fatal.assert_called_once_with("full")


def test_nodes_that_answer_each_other_for_ever_let_the_executor_on(
    mailbox, events
):
    with mailbox.in_use():
        numbers = intra_process.publisher(Recorded(events))
        intra_process.subscribe(
            "/numbers", lambda m, _: numbers.publish(m + 1), NEWEST
        )
    numbers.publish(1)
    for _ in range(3):
        mailbox.deliver()
    assert mailbox.waiting
    assert events == [
        ("topic", number)
        for number in range(1, 3 * intra_process.DELIVERIES_MAX + 2)
    ]


def carried(made, number):
    """A number whose message is noted in `made` when it is made."""
    return Carried(number, number, lambda: made.append(number) or -number)


@pytest.mark.parametrize("profile", [qos.SENSOR, qos.CONTROL])
def test_a_value_becomes_a_message_only_for_a_subscriber_by_dds(
    events, profile
):
    """A latched topic keeps the last values for the first one, and is published from then on."""
    made, topic = [], Recorded(events, profile)
    send = intra_process.publisher(topic).publish
    for number in range(1, 61):
        send(carried(made, number))
    assert events == made == []
    topic.subscribers = 1
    send(carried(made, 61))
    is_latched = profile is qos.CONTROL
    heard = [*range(11, 61), 61] if is_latched else [61]
    assert events == [("topic", -number) for number in heard]
    topic.subscribers = 0
    send(carried(made, 62))
    assert made == heard + [62] * is_latched


def test_a_reader_of_the_process_decodes_a_value_without_its_message(
    mailbox, events
):
    made = []
    with mailbox.in_use():
        numbers = intra_process.publisher(Recorded(events))
        intra_process.subscribe(
            "/numbers",
            lambda m, _: events.append((decode.stamp(m), decode.imu(m))),
            EVERY,
        )
    numbers.publish(carried(made, 7))
    mailbox.deliver()
    assert events == [(7, 7)]
    assert made == []


def test_a_field_of_a_value_is_read_from_its_message_which_is_made_once():
    made = []
    reading = Carried(1, None, lambda: made.append(1) or 3 + 4j, status=2)
    assert (reading.status, made) == (2, [])
    assert (reading.real, reading.imag, reading.message) == (3, 4, 3 + 4j)
    assert made == [1]
