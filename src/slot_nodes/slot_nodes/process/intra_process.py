"""Intra-process communication: a message goes to the nodes of its process as the object it is.

It also goes out on its topic, after the nodes of the process have answered it: the command that it
leads to does not wait until it is serialized, nor for other work that `afterwards` puts off. A node
that reads a topic of its process has no DDS subscription to it.

What is `Carried` becomes a message only for subscribers by DDS, or a recorder. On a transient-local
topic without one the last values are kept, and are published once there is one; from then on all
are, since DDS would hand the last messages before a gap to another late subscriber.
"""

from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from itertools import count
from typing import Any

from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile

from slot_core.messages.carried import Carried

# a message and its number on the topic, from 1
Receive = Callable[[Any, int], None]
Reader = tuple[Receive, bool]  # bool: the newest message only
Write = Callable[[Any], None]  # of a message
# messages delivered in a row: robot and controller in lockstep always have another one
DELIVERIES_MAX = 250


class Mailbox:
    """Topics that the nodes of one process publish, and the messages that wait for its nodes."""

    def __init__(self) -> None:
        self._readers: dict[str, list[Reader]] = {}
        self._early: dict[str, list[tuple[Reader, Callable[[], Any]]]] = {}
        self._recorders: dict[str, tuple[Write, Callable[[], Any]]] = {}
        self._queue: deque[tuple[Receive, Any, int]] = deque()
        self._newest: dict[Receive, tuple[Any, int]] = {}
        self._later: deque[Callable[[], None]] = deque()

    @contextmanager
    def in_use(self) -> Iterator[None]:
        """Nodes made in the block publish and read the topics through this mailbox."""
        global _present  # noqa: PLW0603 - a node does not know in which process it is
        _present = self
        try:
            yield
        finally:
            _present = None

    def add_reader(self, topic: str, reader: Reader) -> bool:
        """Add a reader; false if no node of the process publishes the topic."""
        if topic not in self._readers:
            return False
        self._readers[topic].append(reader)
        return True

    def add_early_reader(
        self, topic: str, reader: Reader, unsubscribe: Callable[[], Any]
    ) -> None:
        """Add a reader subscribed by DDS, until a node of the process publishes the topic."""
        if self.add_reader(topic, reader):
            unsubscribe()
            return
        self._early.setdefault(topic, []).append((reader, unsubscribe))

    def readers(self, topic: str) -> list[Reader]:
        """The readers of a topic that is published; more may come."""
        readers = self._readers.setdefault(topic, [])
        for reader, unsubscribe in self._early.pop(topic, ()):
            unsubscribe()
            readers.append(reader)
        return readers

    def add_recorder(
        self, topic: str, write: Write, unsubscribe: Callable[[], Any]
    ) -> None:
        """Add a recorder subscribed by DDS, until a node of the process publishes the topic."""
        self._recorders[topic] = write, unsubscribe

    def recorder(self, topic: str) -> Write | None:
        """Function that records a topic that a node of the process publishes; None: nobody does."""
        if topic not in self._recorders:
            return None
        write, unsubscribe = self._recorders[topic]
        unsubscribe()
        self._recorders[topic] = write, lambda: None
        return write

    @property
    def waiting(self) -> bool:
        """Whether a message waits."""
        return bool(self._queue or self._newest or self._later)

    def put(self, reader: Reader, message: Any, number: int) -> None:
        """Queue a message for a node; the newest message only replaces the one that waits."""
        receive, newest_only = reader
        if newest_only:
            self._newest[receive] = message, number
        else:
            self._queue.append((receive, message, number))

    def put_off(self, act: Callable[[], None]) -> None:
        """Call `act` when no message waits."""
        self._later.append(act)

    def deliver(self) -> None:
        """Deliver at most DELIVERIES_MAX messages, the newest ones last; then run the postponed calls.

        What a node publishes meanwhile is delivered too.
        """
        delivered = 0
        while delivered < DELIVERIES_MAX and (self._queue or self._newest):
            delivered += 1
            if self._queue:
                receive, message, number = self._queue.popleft()
            else:
                receive = next(iter(self._newest))
                message, number = self._newest.pop(receive)
            receive(message, number)
        while self._later:
            self._later.popleft()()


class IntraProcessPublisher:
    """Publisher on a topic for the nodes of the same process and for all others."""

    def __init__(self, publisher: Publisher, mailbox: Mailbox | None) -> None:
        """mailbox: None for a node that is alone in its process."""
        self._publisher, self._mailbox = publisher, mailbox
        self._readers = mailbox.readers(publisher.topic_name) if mailbox else []
        self.record = (
            mailbox.recorder(publisher.topic_name) if mailbox else None
        )
        self._number = count(1)
        profile = publisher.qos_profile
        self._is_latched = (
            profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
        )
        # that nobody has heard; None: every message is published
        self._kept: deque[Carried] | None = deque(
            maxlen=profile.depth if self._is_latched else 0
        )

    def publish(self, message: Any) -> None:
        """Hand a message over and publish it later; without a reader publish it now."""
        if self._mailbox is None or not self._readers:
            self._send(message)
            return
        number = next(self._number)
        for reader in self._readers:
            self._mailbox.put(reader, message, number)
        self._mailbox.put_off(partial(self._send, message))

    def _send(self, message: Any) -> None:
        """Record a message, publish it by DDS; keep it if it is `Carried` and nobody would hear it."""
        if self.record is not None:
            self.record(message)
        if type(message) is not Carried:
            self._publisher.publish(message)
            return
        if self._kept is not None:
            if not self._publisher.get_subscription_count():
                self._kept.append(message)
                return
            for kept in self._kept:
                self._publisher.publish(kept.message)
            if self._is_latched:
                self._kept = None
        self._publisher.publish(message.message)

    @property
    def topic_name(self) -> str:
        """Name of the topic, with its namespace."""
        return self._publisher.topic_name

    def get_subscription_count(self) -> int:
        """Number of subscriptions to the topic by DDS."""
        return self._publisher.get_subscription_count()


_present: Mailbox | None = None


def afterwards() -> Callable[[Callable[[], None]], None]:
    """For a node under construction: a function that postpones calls that are not urgent.

    It waits until the nodes of the process have answered what was published; a node that is alone
    in its process does it at once.
    """
    return _call if _present is None else _present.put_off


def _call(act: Callable[[], None]) -> None:
    act()


def publisher(made: Publisher) -> Any:
    """The publisher for a node that is being made."""
    return IntraProcessPublisher(made, _present)


def record(topic: str, write: Write, unsubscribe: Callable[[], Any]) -> None:
    """Let `write` have the messages of a topic that a node of the process made later publishes.

    Then the subscription to it by DDS is ended by `unsubscribe`.
    """
    if _present is not None:
        _present.add_recorder(topic, write, unsubscribe)


def subscribe(topic: str, receive: Receive, profile: QoSProfile) -> bool:
    """Subscribe a node that is being made to a topic of its process; false if it has none such.

    With a depth of 1 the node receives the newest message only.
    """
    return _present is not None and _present.add_reader(
        topic, (receive, profile.depth == 1)
    )


def subscribe_later(
    topic: str,
    receive: Receive,
    profile: QoSProfile,
    unsubscribe: Callable[[], Any],
) -> None:
    """Subscribe a node that is being made to a topic that a node of its process may publish.

    Then its subscription by DDS is ended by `unsubscribe`.
    """
    if _present is not None:
        _present.add_early_reader(
            topic, (receive, profile.depth == 1), unsubscribe
        )
