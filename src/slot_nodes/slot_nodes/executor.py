"""An executor for nodes whose callbacks are short and many."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any

from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.timer import Timer
from rclpy.utilities import timeout_sec_to_nsec
from rclpy.waitable import NumberOfEntities

KINDS = ("subscription", "guard_condition", "timer", "client", "service")  # as a wait set counts


class DirectExecutor(SingleThreadedExecutor):
    """Calls back at once for messages and timers; leaves services and all else to the library.

    The library makes a task of every callback, wakes itself twice for it and gathers what to wait
    for anew each time: most of a node's CPU time, on cores that the next node in the chain needs.
    A callback for a message or a timer may not await, and no node may have guard conditions.
    """

    def __init__(self, *, context: Context | None = None) -> None:
        self._is_stale = True
        super().__init__(context=context)

    def wake(self) -> None:
        """Wait anew, for other things than before."""
        self._is_stale = True
        super().wake()

    def spin_once(self, timeout_sec: float | None = None) -> None:
        """Wait, at most `timeout_sec` (s), and answer what is there.

        Raises ExternalShutdownException when the context has ended, and what a callback raises.
        """
        self._wait(timeout_sec)
        timers, subscriptions = self._ready("timer"), self._ready("subscription")
        for subscription in subscriptions:
            _call(self._take_subscription(subscription))
        for timer in timers:
            if _is_due(timer):
                _call(self._take_timer(timer))
        if self._context.ok() and self._has_others():
            self._is_stale = True  # a node may have come or gone
            super().spin_once(timeout_sec=0.0)

    def _wait(self, timeout_sec: float | None) -> None:
        if self._is_stale:
            self._gather()
        wait_set = self._wait_set
        wait_set.clear_entities()
        for kind in KINDS:
            add = getattr(wait_set, f"add_{kind}")
            for entity in self._entities[kind]:
                add(entity.handle)
        for waitable in self._waitables:
            waitable.add_to_wait_set(wait_set)
        wait_set.wait(timeout_sec_to_nsec(timeout_sec))
        if not self._context.ok():
            raise ExternalShutdownException

    def _gather(self) -> None:
        """What the nodes have to be waited for, with what wakes the executor itself."""
        self._is_stale = False
        nodes = self.get_nodes()
        self._entities: dict[str, list[Any]] = {
            "subscription": [e for node in nodes for e in node.subscriptions],
            "guard_condition": [self._guard, self._sigint_gc],
            "timer": [e for node in nodes for e in node.timers],
            "client": [e for node in nodes for e in node.clients],
            "service": [e for node in nodes for e in node.services],
        }
        self._waitables = [waitable for node in nodes for waitable in node.waitables]
        count = NumberOfEntities(*(len(self._entities[kind]) for kind in KINDS))
        for waitable in self._waitables:
            count += waitable.get_num_entities()
        self._wait_set = rclpy_implementation.WaitSet(
            *(getattr(count, name) for name in NumberOfEntities.__slots__), self._context.handle
        )

    def _ready(self, kind: str) -> list[Any]:
        ready = self._wait_set.get_ready_entities(kind)
        return [e for e in self._entities[kind] if e.handle.pointer in ready] if ready else []

    def _has_others(self) -> bool:
        """Whether anything but a message or a timer has ended the wait."""
        kinds = ("guard_condition", "client", "service")
        return any(map(self._wait_set.get_ready_entities, kinds)) or any(
            waitable.is_ready(self._wait_set) for waitable in self._waitables
        )


def _is_due(timer: Timer) -> bool:
    """Whether a timer is still there and due: a callback before may have ended or set it back."""
    try:
        with timer.handle:
            return timer.handle.is_timer_ready()
    except InvalidHandle:
        return False


def _call(execute: Callable[[], Coroutine[Any, Any, None]] | None) -> None:
    """Run what the library has taken, to its end."""
    if execute is None:
        return
    try:
        execute().send(None)
    except StopIteration:
        return
    raise RuntimeError("a callback for a message or a timer awaits")
