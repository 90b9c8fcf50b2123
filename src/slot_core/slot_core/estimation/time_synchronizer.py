"""Matches messages of several topics by their stamp."""

from typing import Any


class TimeSynchronizer:
    """Collects one item per topic and stamp; a set is complete when every topic has an item.

    At most `depth` incomplete sets are kept; the oldest by arrival is dropped first. So a lost
    message costs one tick, and a clock that is set back needs no special treatment.
    """

    def __init__(self, *topics: str, depth: int = 50):
        self._topics, self._depth = topics, depth
        self._sets: dict[int, dict[str, Any]] = {}

    def add(self, topic: str, stamp: int, item: Any) -> tuple[Any, ...] | None:
        """Add an item; return the set of its stamp, in the order of the topics, once complete."""
        items = self._sets.setdefault(stamp, {})
        items[topic] = item
        if len(items) == len(self._topics):
            del self._sets[stamp]
            return tuple(items[t] for t in self._topics)
        if len(self._sets) > self._depth:
            del self._sets[next(iter(self._sets))]
        return None
