"""Clocks of the simulated robot: when its time advances.

    LockstepClock   from one reading that is answered to the next
    RealTimeClock   with another clock, in bounded portions
    BusClock        as RealTimeClock, but stops for a late driver of emulated servos

Times are ns.
"""

import enum
import math
from collections.abc import Iterator

from slot_core.clock import LOCKSTEP_START, SECOND, to_ns
from slot_core.servos.brand import EmulatedServos
from slot_core.simulation.plant import RobotSimulator
from slot_core.simulation.readings import (
    ImuReading,
    Reading,
    StampedHealth,
)
from slot_core.simulation.simulated_servos import SimulatedServos

PATIENCE = SECOND // 2  # ns, longest wait for a late driver
# ns, of a wait, between two calls: a longer one was late itself
LONGEST_CALL = SECOND // 100


class Answer(enum.Enum):
    """Answers for which the simulated robot waits in lockstep."""

    COMMAND = "a command of the tendons"
    STATE = "a state of the supervisor"


ANSWERED = (ImuReading, StampedHealth)


class LockstepClock:
    """Clock that stops at each reading that is answered until its answer arrives.

    The sample of the IMU that leads to a tick of the controller is answered by a command with the
    tick's stamp; a report of the servos by the supervisor's state with its stamp. So one node works at a
    time, and the order of processes and messages has no effect. The first two, at rest, are
    repeated until answered.
    """

    def __init__(
        self, plant: RobotSimulator, servos: SimulatedServos, period: float
    ) -> None:
        """`period`: between two ticks of the controller, s."""
        self._plant, self._servos = plant, servos
        self._period = to_ns(period)
        # kind and stamp of the answer
        self._awaited: tuple[Answer, int] = (Answer.COMMAND, LOCKSTEP_START)
        self._tick = LOCKSTEP_START  # ns, that was answered last
        self.running = False

    def at_rest(self) -> list[Reading]:
        """Readings at rest, repeated until they are answered, before the clock starts."""
        return (
            self._plant.readings_at_rest(LOCKSTEP_START)
            if self._awaited[0] is Answer.COMMAND
            else [self._servos.report()]
        )

    def advance_on_answer(self, kind: Answer, stamp: int) -> Iterator[Reading]:
        """Yield the readings up to the next that needs an answer, if this is the awaited answer."""
        if self._awaited != (kind, stamp):
            return
        if not self.running and kind is Answer.COMMAND:
            report = self._servos.report()
            self._awaited = Answer.STATE, report.stamp
            yield report
            return
        if not self.running:
            self.running = True
            self._plant.start(LOCKSTEP_START)
            self._servos.start()
        answer = None
        while answer is None:
            for reading in self._plant.advance_to_reading(*ANSWERED):
                yield reading
            answer = self._answer_to(reading)
        self._awaited = answer

    def _answer_to(self, reading: Reading) -> tuple[Answer, int] | None:
        """Answer that a reading leads to, and its stamp (ns), as the state estimator ticks."""
        if isinstance(reading, StampedHealth):
            return Answer.STATE, reading.stamp
        tick = self._tick + self._period
        if reading.stamp < tick:
            return None
        self._tick = tick
        return Answer.COMMAND, self._tick


class RealTimeClock:
    """Time that follows another clock."""

    def __init__(self, plant: RobotSimulator, portion: int) -> None:
        """`portion`: largest time to simulate at once, ns, so that commands are taken between."""
        self._plant, self._portion = plant, portion

    def advance_to(self, now: int) -> Iterator[Reading]:
        """Advance towards `now` by at most one portion."""
        return self._plant.advance(min(now, self._plant.now + self._portion))


class BusClock(RealTimeClock):
    """Time that waits for the driver of emulated servos before a bus watchdog would stop them.

    The driver runs on the same machine, which may delay it by more than the watchdog's time. On a
    robot that delay does not exist, so the robot's time stops until the next instruction. A driver
    that sends none for PATIENCE has ended: then the time advances, and the watchdogs stop the
    servos as soon after the last instruction, on the robot's clock, as on a robot.
    """

    def __init__(
        self, plant: RobotSimulator, servos: EmulatedServos, portion: int
    ) -> None:
        """`servos`: of the plant; `portion` as for RealTimeClock."""
        super().__init__(plant, portion)
        self._servos, self._step = servos, to_ns(plant.robot.scene.solver.step)
        self._last = 0  # ns, `now` of the last call
        self.waited = 0  # ns, of the present wait for the driver

    def advance_to(self, now: int) -> Iterator[Reading]:
        """Advance towards `now` by at most one portion, and not past the next bus watchdog."""
        passed, self._last = now - self._last, now
        until, due = (
            min(now, self._plant.now + self._portion),
            self._watchdog_due(),
        )
        if due is None or until <= due:
            self.waited = 0
        else:
            self.waited += min(passed, LONGEST_CALL)
            until = until if self.waited > PATIENCE else due
        return self._plant.advance(until)

    def _watchdog_due(self) -> int | None:
        """Time (ns) up to which no bus watchdog stops a servo; None if none is armed."""
        left = self._servos.watchdog_left()
        if math.isinf(left):
            return None
        return (
            self._plant.now
            + (math.floor(left * SECOND) // self._step - 1) * self._step
        )
