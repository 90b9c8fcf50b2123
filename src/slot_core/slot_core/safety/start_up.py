"""Standing up and walking off without an operator."""

from __future__ import annotations

from slot_core.safety.states import LET_GO
from slot_core.safety.supervisor import Request, Supervisor


class StartUp:
    """Asks the supervisor for one step after the other until each is granted, once."""

    def __init__(self, *steps: Request):
        self._left = list(steps)

    def urge(self, supervisor: Supervisor, now: int) -> str:
        """Ask for the next step at `now` (ns); why it is refused, or "".

        Once the robot has been slack for a reason, an operator decides.
        """
        if supervisor.state in LET_GO:
            self._left.clear()
        if not self._left:
            return ""
        refusal = supervisor.request(now, self._left[0], "the start-up")
        if not refusal:
            del self._left[0]
        return refusal
