"""The supervisor on a simulated clock, and its start-up without an operator.

It steps on the reports of the servos, in a fixed order. Inputs carry the time at which they arrived
on the robot's clock. Inputs since the last step are taken in the order of these times, so the order
of processes and messages has no effect, and equal runs are equal to the last bit.
"""

from collections.abc import Callable

from slot_core.safety.settings import NODES
from slot_core.safety.states import RELEASED, Request
from slot_core.safety.supervisor import Report, Supervisor
from slot_core.safety.watchdog import ServoHealth

NOT_THE_FIRST = "start-up: the servos have obeyed an earlier supervisor, so an operator decides"
# inputs of one time are taken in this order
SOURCES = ("joints", *NODES, "e-stop")
Take = Callable[[int], object]


class StartUp:
    """Sequence of requests to the supervisor, each repeated until it is granted.

    The sequence ends with the operator's first request, granted or not, and when the robot enters
    RELAX, ESTOP or FAULT. It does not begin where the servos have obeyed an earlier supervisor,
    which may have been in ESTOP or FAULT. From then on only the operator makes requests.
    """

    def __init__(self, *steps: Request):
        self._left = list(steps)
        self._began: int | None = None  # ns, of the first call
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


class TickedSupervisor:
    """Supervisor, its start-up, and the inputs that it takes at its next step."""

    def __init__(self, supervisor: Supervisor, start_up: StartUp) -> None:
        self.supervisor = supervisor
        self._start_up = start_up
        self._waiting: list[tuple[int, int, Take]] = []

    def add(self, source: str, time: int, take: Take) -> None:
        """An input of one of SOURCES that arrived at `time` (ns), with which `take` is called."""
        self._waiting.append((time, SOURCES.index(source), take))

    def step(self, now: int, health: ServoHealth | None) -> Report:
        """Take the inputs, then the servos' report at `now` (ns) if there is one, and decide."""
        waiting, self._waiting = self._waiting, []
        for time, _, take in sorted(waiting, key=lambda item: item[:2]):
            take(time)
        if health is not None:
            self.supervisor.receive_health(now, now, health)
        self._start_up.request_next(self.supervisor, now)
        return self.supervisor.step(now)


class LockstepInputs:
    """Messages of a graph in lockstep, until all that precede a report of the servos are there.

    A report names the newest command at the servos and when it arrived there. Estimate, forces and
    command of that stamp precede it, and are given the same time of arrival; joints have their own.
    """

    def __init__(self) -> None:
        self._waiting: list[tuple[str, int, Take]] = []
        self._newest = dict.fromkeys(NODES, 0)  # ns, stamp

    def add(self, source: str, stamp: int, take: Take) -> None:
        """A message of a node or of the "joints"; `take` is called with its time of arrival."""
        self._waiting.append((source, stamp, take))
        if source in self._newest:
            self._newest[source] = max(stamp, self._newest[source])

    def are_complete(self, health: ServoHealth) -> bool:
        """Whether all messages that precede a report are there."""
        return min(self._newest.values()) >= health.commanded

    def pass_to(self, ticked: TickedSupervisor, health: ServoHealth) -> None:
        """Give the messages that precede a report to the supervisor."""
        waiting, self._waiting = self._waiting, []
        for source, stamp, take in waiting:
            if source == "joints":
                ticked.add(source, stamp, take)
            elif stamp <= health.commanded:
                ticked.add(source, health.written, take)
            else:
                self._waiting.append((source, stamp, take))
