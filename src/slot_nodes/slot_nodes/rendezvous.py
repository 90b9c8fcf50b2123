"""Messages of several topics brought together by their stamp."""

from __future__ import annotations

from typing import Any


class Rendezvous:
    """Collects one item per topic and stamp; a set is complete when every topic has come.

    At most `depth` incomplete sets are kept, the one begun first goes first: a lost message costs
    one tick, and stamps from a clock that has been set back are as good as any.
    """

    def __init__(self, *topics: str, depth: int = 50):
        self._topics, self._depth = topics, depth
        self._sets: dict[int, dict[str, Any]] = {}

    def add(self, topic: str, stamp: int, item: Any) -> tuple[Any, ...] | None:
        """Add an item; return all items of that stamp in the order of the topics, or None."""
        items = self._sets.setdefault(stamp, {})
        items[topic] = item
        if len(items) == len(self._topics):
            del self._sets[stamp]
            return tuple(items[t] for t in self._topics)
        if len(self._sets) > self._depth:
            del self._sets[next(iter(self._sets))]
        return None
