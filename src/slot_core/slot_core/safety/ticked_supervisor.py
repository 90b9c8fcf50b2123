"""The supervisor on a simulated clock: it steps on the reports of the servos, in a fixed order.

Inputs carry the time at which they arrived on the robot's clock. Those that came since the last
step are taken in the order of these times, so the order of processes and messages has no effect,
and equal runs are equal to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable

from slot_core.safety.servo_health import ServoHealth
from slot_core.safety.settings import NODES
from slot_core.safety.start_up import StartUp
from slot_core.safety.supervisor import Report, Supervisor

SOURCES = ("joints", *NODES, "e-stop")  # inputs of one time are taken in this order
Take = Callable[[int], object]


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
