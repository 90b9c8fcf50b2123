"""Effort of a policy: how much it computes in a tick, less where its time runs short.

It is chosen from the wall time of the ticks before. A plan names it at the end of its message, from
which a replay takes it; where the clock waits for the plan it is `FULL`.
"""

import enum

SHARE = 0.2  # C, of the period: a longer tick is short of time
CALM = 15  # C, ticks with enough time after which more is computed


class Effort(enum.StrEnum):
    """Efforts in their order, each with what a plan's message says of it."""

    FULL = ""
    SLOPES = "time is short: a fifth of the slopes anew"
    GAIT = "time is short: the gait's angles"

    @classmethod
    def of(cls, message: str) -> "Effort":
        """Effort that a plan's message names."""
        return next(e for e in reversed(cls) if message.endswith(e))


class EffortChoice:
    """Choice of the effort: less after a tick that is short of time, more after a while without."""

    def __init__(self) -> None:
        self._level = self._calm = 0

    def add(self, elapsed: float, period: float) -> Effort:
        """Effort of the next tick after one of `elapsed`, s, of its period, s."""
        self._calm += 1
        if elapsed > SHARE * period:
            self._level, self._calm = min(self._level + 1, len(Effort) - 1), 0
        elif self._calm >= CALM:
            self._level, self._calm = max(self._level - 1, 0), 0
        return [*Effort][self._level]
