"""Servo session: bus cycles of the driver under the command watchdog.

The watchdog (`safety/command_watchdog.py`) decides on the action from commands, permissions and
faults. A fault of a servo takes two ways to torque off: the watchdog begins a ramp to slack in the
same cycle, and the supervisor, which reads it on `/servo_health`, then permits RELAX and finally
OFF, which switches torque off at once if it is still on.
Times are those of the driver's clock, which never goes back, ns.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from slot_core.clock import to_ns, to_seconds
from slot_core.config import ConfigError
from slot_core.dynamixel.checks import ServoInfo
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.errors import RefusedError, ServoError
from slot_core.dynamixel.joints import Joint
from slot_core.dynamixel.state import Cycle, Health, JointReading, TorqueOff
from slot_core.robot import LEGS, Array
from slot_core.safety.command_gate import AT_REST, Action
from slot_core.safety.command_guard import NO_LIMITS, CommandGuard
from slot_core.safety.command_watchdog import Permission
from slot_core.safety.servo_health import ServoHealth
from slot_core.safety.settings import ServoLimits

LATE = 1.5  # periods between two cycles that count as an overrun
STARTS = (Action.HOLD, Action.PASS)  # actions under which torque comes on
DURATIONS = 10_000  # of bus cycles that are kept for a query


@dataclass(frozen=True)
class BusPace:
    """Rate and duration of the bus cycles since the last query."""

    rate: float  # cycles a second
    mean: float  # s, of the cycles
    longest: float  # s
    overruns: int  # since the start


class ServoSession:
    """The driver and its command watchdog: start, commands, bus cycles, stop."""

    def __init__(
        self,
        driver: Driver,
        angle_max: float,
        period: float,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        """Commands within [0, `angle_max`] (rad); `period` (s) between steps; `stop` uses `sleep`.

        Raises ConfigError for a joint with a smaller range: the gait, the force map and the
        supervisor would not know of it.
        """
        _check_ranges(driver.joints, angle_max)
        self.driver = driver
        self.period = period
        self.action, self.reason = Action.OFF, "not started"
        self.overruns = 0
        self.commanded = 0  # ns, stamp of the last command that was written to the servos
        self.written = 0.0  # s of the driver's clock, when it was written
        self._sleep = sleep
        self._guard = CommandGuard(0.0, angle_max)
        self._slewed = np.zeros(len(LEGS), dtype=bool)
        self._offered = 0  # stamp of the last accepted command
        self._locked = False  # torque went off by a rule of the session or was refused; until OFF
        self._off: TorqueOff | None = None  # of the last ramp, or None: torque went off otherwise
        self._last_step: int | None = None
        self._pause = 0.0  # s, the last between two steps that was long enough for a bus watchdog
        self._last_query: int | None = None
        self._durations: deque[float] = deque(maxlen=DURATIONS)

    @property
    def limits(self) -> ServoLimits | None:
        """Limits that the supervisor has sent, or None."""
        return self._guard.limits

    @property
    def clock_jump(self) -> float:
        """Largest difference between a stamp and the present, s; inf without limits."""
        return self._guard.clock_jump

    def set_limits(self, limits: ServoLimits) -> None:
        """Take the supervisor's limits; raises ConfigError as `CommandGate` does."""
        self._guard.set_limits(limits)

    def configure(self) -> tuple[ServoInfo, ...]:
        """Open the port, check every servo, and switch off torque left on by a killed driver.

        Raises PortError, RefusedError.
        """
        infos = self.driver.configure()
        off = self.driver.torque_off()
        if not off.complete:
            raise RefusedError(list(off.reasons))
        return infos

    def start(self) -> None:
        """Torque on without motion, if the supervisor permits HOLD or PASS and still runs.

        Raises RefusedError with all torque off.
        """
        watchdog = self._guard.watchdog
        if watchdog is None:
            raise RefusedError([NO_LIMITS])
        if watchdog.permission is None or watchdog.permission.action not in STARTS:
            raise RefusedError(["the supervisor does not permit it"])
        age = self.driver.clock() - to_seconds(watchdog.permission.time)
        if age > watchdog.limits.command_hold:
            raise RefusedError([f"the supervisor's permission is {age:.2f} s old"])
        try:
            self.driver.activate()
        except RefusedError as error:
            self.action, self.reason = Action.OFF, f"torque refused: {error}"
            self._locked = True
            raise
        watchdog.engage(self.driver.goals())
        self._last_step, self._pause = None, 0.0
        self.action, self.reason = Action.HOLD, "torque comes on"

    def offer(self, now: int, stamp: int, angle: Array, rate: Array = AT_REST) -> str:
        """Accept angles (4,), rad, with their `stamp` and rate (4,), rad/s; or return why not."""
        fault = self._guard.offer(now, angle, rate)
        if not fault:
            self._offered = stamp
        return fault

    def permit(self, permission: Permission) -> None:
        """Store the supervisor's permission; OFF switches torque off at once."""
        self._guard.permit(permission)
        if permission.action is not Action.OFF:
            return
        if self.driver.active:
            self._switch_off(permission.reason)
        else:
            self.reason = permission.reason
        self._locked = False

    def may_start(self, permission: Permission) -> bool:
        """Whether a permission switches torque on; not after a RELAX or a refusal, until OFF."""
        permits = permission.action in STARTS and self.limits is not None
        return permits and not (self.driver.active or self._locked)

    def relax(self, reason: str) -> None:
        """Ramp the tendons to slack in the next steps, then torque off."""
        self._guard.relax(reason)

    def step(self, now: int) -> Cycle:
        """One bus cycle; raises PortError if the port has disappeared."""
        self._count_overrun(now)
        if self.driver.active:
            self._command(now)
        cycle = self.driver.cycle()
        self._durations.append(cycle.duration)
        if self.action is Action.PASS and self.commanded != self._offered:
            self.commanded, self.written = self._offered, cycle.written
        return cycle

    def _command(self, now: int) -> None:
        """Step the watchdog, and give its goals to the driver."""
        watchdog = self._guard.watchdog
        assert watchdog is not None
        for fault in [*self.driver.faults(), *self.silent().values()][:1]:
            self.relax(fault + self._delay())
        gated = watchdog.step(now)
        self.action, self.reason = watchdog.action, watchdog.reason
        self._slewed = gated.slewed
        if not gated.torque:
            self._switch_off(self.reason)
            self._locked = bool(self.own_reason)
        elif gated.action is not Action.HOLD:  # goals under HOLD may be below the range of commands
            self.driver.command(gated.angle)

    def _delay(self) -> str:
        """How late the bus cycle was that has tripped a bus watchdog, for the reason; or ""."""
        tripped = any((servo.watchdog or 0) < 0 for servo in self.driver.health)
        return f" after {self._pause:.2f} s without a bus cycle" if tripped and self._pause else ""

    def stop(self) -> TorqueOff:
        """Ramp the tendons to slack, then torque off, read back; blocks during the ramp.

        Torque is switched off even if an exception is raised meanwhile.
        """
        self.driver.bus.port.is_using = False  # an interrupt may have left an exchange unfinished
        self.relax("stopped")
        self._off = None
        try:
            while self.driver.active:
                self.step(to_ns(self.driver.clock()))
                self._sleep(self.period)
        except ServoError:
            pass  # torque goes off without a ramp
        finally:
            off = self._off or self.driver.torque_off()
        if self.action is not Action.OFF:
            self.action, self.reason = Action.OFF, "stopped"
        return off

    def pace(self, now: int) -> BusPace:
        """Rate and duration of the bus cycles since the last call."""
        times = list(self._durations)
        self._durations.clear()
        passed = 0.0 if self._last_query is None else to_seconds(now - self._last_query)
        self._last_query = now
        if not times or passed <= 0.0:
            return BusPace(0.0, 0.0, 0.0, self.overruns)
        return BusPace(len(times) / passed, sum(times) / len(times), max(times), self.overruns)

    @property
    def urgent(self) -> tuple[Any, ...]:
        """Values of the health report whose change is published at once."""
        servos = self.driver.health
        states = tuple((servo.torque, servo.hardware_error) for servo in servos)
        return self.action, self.commanded, states, self._slewed.tobytes()

    def health(self, stamp: int) -> ServoHealth:
        """Health report of the servos at `stamp` (ns of the messages' clock)."""
        servos = self.driver.health
        age = to_ns(self.driver.clock() - self.written)
        return ServoHealth(
            action=self.action,
            reason=self.reason,
            torque=np.array([bool(servo.torque) for servo in servos]),
            silence=np.array([self.driver.silent_for(servo.leg) for servo in servos]),
            goal=self.driver.goals(),
            slewed=self._slewed,
            hardware_error=np.array([servo.hardware_error or 0 for servo in servos]),
            temperature=_known(servos, "temperature"),
            voltage=self.voltage,
            error_rate=np.array([servo.error_rate for servo in servos]),
            commanded=self.commanded,
            written=stamp - age if self.commanded else 0,
        )

    @property
    def voltage(self) -> Array:
        """Supply voltages (4,) that the servos have measured last, V; NaN: not read yet."""
        return _known(self.driver.health, "voltage")

    @property
    def own_reason(self) -> str:
        """Reason of a RELAX begun by the watchdog itself, or ""."""
        return self._guard.own_reason

    @property
    def overdue(self) -> bool:
        """Whether a command or the supervisor's permission is too old."""
        return self._guard.overdue

    def silent(self) -> dict[str, str]:
        """Servos that have not answered for too long: one line each, by leg."""
        limit = math.inf if self.limits is None else self.limits.servo_silent
        ages = [(joint, self.driver.silent_for(joint.leg)) for joint in self.driver.joints]
        return {
            joint.leg: f"{joint.name}: no answer for {age:.2f} s, limit {limit:g} s"
            for joint, age in ages
            if age > limit
        }

    def _switch_off(self, reason: str) -> None:
        """Torque off at once, with its confirmation in `reason`."""
        off = self._off = self.driver.torque_off()
        result = "torque off" if off.complete else "torque NOT off: " + "; ".join(off.reasons)
        self.action, self.reason = Action.OFF, f"{result}, after: {reason}"

    def _count_overrun(self, now: int) -> None:
        """Count an overrun."""
        pause = 0.0 if self._last_step is None else to_seconds(now - self._last_step)
        self.overruns += pause > LATE * self.period
        if pause > self.driver.settings.servo.watchdog:
            self._pause = pause
        self._last_step = now


def _check_ranges(joints: Sequence[Joint], angle_max: float) -> None:
    for joint in joints:
        if joint.low > 0.0 or joint.high < angle_max:
            low, high, largest = map(math.degrees, (joint.low, joint.high, angle_max))
            raise ConfigError(
                f"dynamixel.yaml: joints: range [{low:g}, {high:g}] deg, smaller than that of the"
                f" tendon, [0, {largest:g}] deg; change tendon.angle_max_deg of robot.yaml instead"
            )


def measured(stamp: int, cycle: Cycle, tendon_stall: Array) -> JointReading | None:
    """Joint angles, rates and torques of a cycle; None unless every servo answered.

    The torque is the servo's estimate: its load, a share of the stall torques `tendon_stall` (4,),
    N m on the tendon angle.
    """
    readings = [reading for reading in cycle.readings if reading is not None]
    if len(readings) < len(LEGS):
        return None
    angle, rate, load = (np.array([getattr(r, n) for r in readings]) for n in _MEASURED)
    return JointReading(stamp, angle, rate, load * tendon_stall)


_MEASURED = ("angle", "rate", "load")


def _known(servos: tuple[Health, ...], name: str) -> Array:
    """(4,) values of a field; NaN where it has not been read yet."""
    values = [getattr(servo, name) for servo in servos]
    return np.array([math.nan if value is None else value for value in values])
