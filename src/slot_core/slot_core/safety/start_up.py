"""Requests that take the robot from IDLE to WALKING without an operator."""

from __future__ import annotations

from slot_core.safety.requests import Request
from slot_core.safety.states import RELEASED
from slot_core.safety.supervisor import Supervisor

NOT_THE_FIRST = (
    "start-up: the servos have obeyed an earlier supervisor, so an operator decides"
)


class StartUp:
    """Sequence of requests to the supervisor, each repeated until it is granted.

    The sequence ends with the operator's first request, granted or not, and when the robot enters
    RELAX, ESTOP or FAULT. It does not begin where the servos have obeyed an earlier supervisor,
    which may have been in ESTOP or FAULT. From then on only the operator makes requests.
    """

    def __init__(self, *steps: Request):
        self._left = list(steps)
        self._began: int | None = (
            None  # ns, before the first message of this supervisor
        )
        self._hindrance = ""

    def request_next(self, supervisor: Supervisor, now: int) -> str:
        """Make the next request at `now` (ns); returns why not, or why it is refused, or ""."""
        self._began = now if self._began is None else self._began
        if supervisor.operated or supervisor.state in RELEASED:
            self._left.clear()
        if not self._left:
            return ""
        if supervisor.supervised is None:
            return "start-up: no report of the servos yet"
        if 0 < supervisor.supervised < self._began:
            self._hindrance = NOT_THE_FIRST
        if self._hindrance:
            return self._hindrance
        refusal = supervisor.request(now, self._left[0], "the start-up")
        if not refusal:
            del self._left[0]
        return refusal
