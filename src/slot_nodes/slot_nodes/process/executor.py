"""Executor for nodes with many short callbacks."""

from collections.abc import Callable, Coroutine
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.timer import Timer
from rclpy.utilities import timeout_sec_to_nsec
from rclpy.waitable import NumberOfEntities

from slot_nodes.process.intra_process import Mailbox

# order of a wait set
KINDS = ("subscription", "guard_condition", "timer", "client", "service")


class PolledGroup(MutuallyExclusiveCallbackGroup):
    """Callback group of subscriptions whose messages their node takes when it needs them.

    A DirectExecutor wakes for these messages, and for the events of their topics, only while they
    are `awaited`.
    """

    def __init__(self) -> None:
        super().__init__()
        self.awaited = False


class DirectExecutor(SingleThreadedExecutor):
    """Calls the callbacks of messages and timers directly; rclpy serves everything else.

    rclpy's executor makes a task of every callback, wakes itself twice for it and collects the
    entities to wait for each time. That takes most of a node's CPU time, on cores that the next
    node in the chain needs. Callbacks of messages and timers must not await, and nodes must not
    have guard conditions.

    It also delivers the messages of its mailbox, from nodes of the same process, those of which a
    node wants the newest only last. A message that leads to others in the mailbox is followed by
    all that wait behind it, so that such a node gets one of them.
    """

    def __init__(
        self, mailbox: Mailbox | None = None, *, context: Context | None = None
    ) -> None:
        self._entities_changed = True
        self._mailbox = mailbox or Mailbox()
        super().__init__(context=context)

    def wake(self) -> None:
        """Interrupt the wait and collect the entities again."""
        self._entities_changed = True
        super().wake()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait at most `timeout_sec` (s) and run the callbacks that are ready.

        Raises ExternalShutdownException when the context has ended, and what a callback raises.
        """
        self._serve(0.0 if self._mailbox.waiting else timeout_sec)
        self._mailbox.deliver()

    def _serve(self, timeout_sec: float | None) -> None:
        """Wait and run the callbacks that are ready."""
        self._wait(timeout_sec)
        timers, subscriptions = (
            self._ready("timer"),
            self._ready("subscription"),
        )
        for subscription in subscriptions:
            for _ in range(subscription.qos_profile.depth):
                if not (
                    _call(self._take_subscription(subscription))
                    and self._mailbox.waiting
                ):
                    break
        for timer in timers:
            if _is_due(timer):
                _call(self._take_timer(timer))
        if self._context.ok() and self._has_others():
            # a node may have been added or removed
            self._entities_changed = True
            super().spin_once(timeout_sec=0.0)
            # callbacks of an answer: nothing would wake rclpy, whose spin runs one task at a time
            for _ in [
                t for t, *_ in self._tasks if not (t.done() or t.executing())
            ]:
                super().spin_once(timeout_sec=0.0)
            # rclpy takes the trigger of a signal, but ends only if the context has ended by then
            if (
                self._sigint_gc is not None
                and self._sigint_gc._executor_triggered
            ):
                raise ExternalShutdownException

    def _wait(self, timeout_sec: float | None) -> None:
        if self._entities_changed:
            self._collect_entities()
        wait_set = self._wait_set
        wait_set.clear_entities()
        for kind in KINDS:
            add = getattr(wait_set, f"add_{kind}")
            for entity in filter(_is_awaited, self._entities[kind]):
                add(entity.handle)
        for waitable in filter(_is_awaited, self._waitables):
            waitable.add_to_wait_set(wait_set)
        wait_set.wait(timeout_sec_to_nsec(timeout_sec))
        # rclpy's handler of signals ends the wait just before it ends the context
        if self._is_triggered(self._sigint_gc) or not self._context.ok():
            raise ExternalShutdownException

    def _is_triggered(self, guard: Any) -> bool:
        return guard.handle.pointer in self._wait_set.get_ready_entities(
            "guard_condition"
        )

    def _collect_entities(self) -> None:
        """Collect the entities of the nodes, and the guard conditions that wake the executor."""
        self._entities_changed = False
        nodes = self.get_nodes()
        self._entities: dict[str, list[Any]] = {
            "subscription": [e for node in nodes for e in node.subscriptions],
            "guard_condition": [self._guard, self._sigint_gc],
            "timer": [e for node in nodes for e in node.timers],
            "client": [e for node in nodes for e in node.clients],
            "service": [e for node in nodes for e in node.services],
        }
        self._waitables = [
            waitable for node in nodes for waitable in node.waitables
        ]
        count = NumberOfEntities(*(len(self._entities[kind]) for kind in KINDS))
        for waitable in self._waitables:
            count += waitable.get_num_entities()
        self._wait_set = rclpy_implementation.WaitSet(
            *(getattr(count, name) for name in NumberOfEntities.__slots__),
            self._context.handle,
        )

    def _ready(self, kind: str) -> list[Any]:
        ready = self._wait_set.get_ready_entities(kind)
        return (
            [e for e in self._entities[kind] if e.handle.pointer in ready]
            if ready
            else []
        )

    def _has_others(self) -> bool:
        """Whether anything but a message or a timer is ready."""
        return (
            self._is_triggered(self._guard)
            or any(
                map(self._wait_set.get_ready_entities, ("client", "service"))
            )
            or any(
                w.is_ready(self._wait_set)
                for w in filter(_is_awaited, self._waitables)
            )
        )


def _is_awaited(entity: Any) -> bool:
    """Whether the executor wakes for an entity."""
    group = entity.callback_group
    return not isinstance(group, PolledGroup) or group.awaited


def _is_due(timer: Timer) -> bool:
    """Whether a timer exists and is due: an earlier callback may have destroyed or reset it."""
    try:
        with timer.handle:
            return timer.handle.is_timer_ready()
    except InvalidHandle:
        return False


def _call(execute: Callable[[], Coroutine[Any, Any, None]] | None) -> bool:
    """Run the callback of an entity that rclpy has taken, to its end; whether there was one."""
    if execute is None:
        return False
    try:
        execute().send(None)
    except StopIteration:
        return True
    raise RuntimeError("a callback for a message or a timer awaits")
