"""Optional nodes such as recorder and viewer: the robot keeps walking when one ends.

The supervisor reports the end. Its node looks for them among the nodes that ROS has discovered. So their end is
noticed whatever has started them, and needs no message of theirs. A node that leaves the graph is
missing at once; one that was killed stays listed until its lease ends (20 s with Fast DDS).
"""

from __future__ import annotations

from collections.abc import Iterable


class OptionalNodes:
    """Nodes that were discovered earlier and are missing now."""

    def __init__(self, names: Iterable[str]) -> None:
        self._names = frozenset(names)
        self._seen: set[str] = set()
        self._gone: list[str] = []

    def look(self, present: Iterable[str]) -> None:
        """Take the names of all nodes that are present."""
        found = self._names.intersection(present)
        self._gone = sorted(self._seen - found)
        self._seen |= found

    @property
    def warnings(self) -> list[str]:
        """One line for each that is gone."""
        return [
            f"node {name} has ended; the robot goes on without it"
            for name in self._gone
        ]
