"""Clock of the supervisor: it never goes back, and names a jump of the clock it follows."""

from slot_core.clock import to_ns, to_seconds


class SteadyClock:
    """Time that never goes back; a jump of the clock adds nothing to it."""

    def __init__(self, jump: float):
        self._jump, self._time = to_ns(jump), 0
        self._last: int | None = None
        self.jumped = ""  # one line on the last jump, until it is cleared

    def advance(self, now: int) -> int:
        """Steady time at `now`, both ns."""
        passed = 0 if self._last is None else now - self._last
        self._last = now
        if abs(passed) > self._jump:
            limit = to_seconds(self._jump)
            self.jumped = (
                f"clock jumped by {to_seconds(passed):+.3g} s, limit {limit:g}"
            )
            passed = 0
        self._time += max(passed, 0)
        return self._time
