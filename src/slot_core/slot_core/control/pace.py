"""Whether a controller keeps up with its inputs."""

from __future__ import annotations


class Pace:
    """Counts the cycles that took too long, and the inputs that were never answered."""

    def __init__(self) -> None:
        self.overruns = 0
        self.skipped = 0
        self._answered: int | None = None

    def add(self, number: int, elapsed: float, period: float) -> None:
        """Take account of a cycle of `elapsed` s, due in `period` s, for input `number`.

        Numbers rise by one with every input of one source; a lower one is of a new source.
        """
        self.overruns += elapsed > period
        if self._answered is not None and number > self._answered:
            self.skipped += number - self._answered - 1
        self._answered = number
