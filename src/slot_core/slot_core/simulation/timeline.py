"""Clock of the simulated robot, and the actions that are due on it."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable
from dataclasses import dataclass, field

from slot_core.clock import to_ns
from slot_core.simulation.readings import Reading


@dataclass(frozen=True, order=True)
class _Event:
    """Action due at `due` (ns); actions of one instant run in the order of `number`."""

    due: int
    number: int
    action: Callable[[], list[Reading]] = field(compare=False)


class Timeline:
    """Time of the robot, ns, and a queue of actions, each of which returns readings."""

    def __init__(self) -> None:
        self.now = 0  # ns
        self._events: list[_Event] = []
        self._number = itertools.count()

    @property
    def started(self) -> bool:
        """Whether anything is scheduled: sensors are read from the start of the clock on."""
        return bool(self._events)

    @property
    def next_due(self) -> int:
        """Time of the next action, ns."""
        return self._events[0].due

    def pop(self) -> _Event:
        """Remove and return the next action."""
        return heapq.heappop(self._events)

    def schedule(self, due: int, action: Callable[[], list[Reading]]) -> None:
        """Schedule an action that returns readings at `due` (ns)."""
        heapq.heappush(self._events, _Event(due, next(self._number), action))

    def act(self, due: int, act: Callable[[], None]) -> None:
        """Schedule an action without readings at `due` (ns)."""

        def action() -> list[Reading]:
            act()
            return []

        self.schedule(due, action)

    def every(self, period: float, read: Callable[[], list[Reading]]) -> None:
        """Schedule a periodic reading (s), first after one period."""
        interval = to_ns(period)

        def action() -> list[Reading]:
            self.schedule(self.now + interval, action)
            return read()

        self.schedule(self.now + interval, action)
