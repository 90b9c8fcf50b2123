"""Requests that take the robot from IDLE to WALKING without an operator."""

from __future__ import annotations

from slot_core.safety.states import RELEASED
from slot_core.safety.supervisor import Request, Supervisor


class StartUp:
    """Sequence of requests to the supervisor, each repeated until it is granted."""

    def __init__(self, *steps: Request):
        self._left = list(steps)

    def request_next(self, supervisor: Supervisor, now: int) -> str:
        """Make the next request at `now` (ns); returns why it is refused, or "".

        The sequence ends when the robot enters RELAX, ESTOP or FAULT; from then on only the
        operator makes requests.
        """
        if supervisor.state in RELEASED:
            self._left.clear()
        if not self._left:
            return ""
        refusal = supervisor.request(now, self._left[0], "the start-up")
        if not refusal:
            del self._left[0]
        return refusal
