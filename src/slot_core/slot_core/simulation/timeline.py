"""Clock of the simulated robot, and the actions that are due on it."""

import heapq
import itertools
from collections.abc import Callable

from slot_core.clock import to_ns
from slot_core.simulation.readings import Reading

# Due time (ns), number by which actions of one instant are ordered, action.
Event = tuple[int, int, Callable[[], list[Reading]]]


class Timeline:
    """Time of the robot, ns, and a queue of actions, each of which returns readings."""

    def __init__(self) -> None:
        self.now = 0  # ns
        self._events: list[Event] = []
        self._number = itertools.count()

    @property
    def started(self) -> bool:
        """Whether anything is scheduled: sensors are read from the start of the clock on."""
        return bool(self._events)

    @property
    def next_due(self) -> int:
        """Time of the next action, ns."""
        return self._events[0][0]

    def pop(self) -> Event:
        """Remove and return the next action."""
        return heapq.heappop(self._events)

    def schedule(self, due: int, action: Callable[[], list[Reading]]) -> None:
        """Schedule an action that returns readings at `due` (ns)."""
        heapq.heappush(self._events, (due, next(self._number), action))

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
