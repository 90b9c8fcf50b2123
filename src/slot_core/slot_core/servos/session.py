"""Servo session: cycles of a servo bus under the watchdog.

The watchdog (`safety/watchdog.py`) decides on the action from commands, permissions and faults. A
fault of a servo takes two ways to torque off: the watchdog begins a ramp to slack in the same
cycle, and the supervisor, which reads it on `/servo_health`, then permits RELAX and finally OFF,
which switches torque off at once if it is still on.
Times are on the bus's clock, which never goes back, ns.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import to_ns, to_seconds
from slot_core.config import ConfigError
from slot_core.robot import LEGS
from slot_core.safety.rate_limiter import AT_REST
from slot_core.safety.states import Action
from slot_core.safety.watchdog import (
    NO_LIMITS,
    Permission,
    ServoHealth,
    Watchdog,
)
from slot_core.servos.servo_bus import (
    Cycle,
    RefusedError,
    ServoBus,
    ServoError,
    ServoStatus,
    TorqueOff,
)

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
    """A servo bus and its watchdog: start, commands, bus cycles, stop."""

    def __init__(
        self,
        bus: ServoBus,
        angle_max: float,
        period: float,
        sleep: Callable[[float], None],
    ) -> None:
        """Commands within [0, `angle_max`] (rad); `period` (s) between steps; `stop` uses `sleep`.

        Raises ConfigError for servos with a smaller range: the gait, the force map and the
        supervisor would not know of it.
        """
        facts = bus.facts
        if facts.low > 0.0 or facts.high < angle_max:
            low, high, largest = map(
                math.degrees, (facts.low, facts.high, angle_max)
            )
            raise ConfigError(
                f"{facts.brand}.yaml: joints: range [{low:g}, {high:g}] deg, smaller than that of"
                f" the tendon, [0, {largest:g}] deg; change tendon.angle_max_deg of robot.yaml"
                " instead"
            )
        self.bus = bus
        self.period = period
        self.action, self.reason = Action.OFF, "not started"
        self.overruns = 0
        # ns, stamp of the last command that was written to the servos
        self.commanded = 0
        self.written = 0.0  # s of the bus's clock, when it was written
        self._sleep = sleep
        self.watchdog = Watchdog(angle_max)
        self._slewed = np.zeros(len(LEGS), dtype=bool)
        self._offered = 0  # stamp of the last accepted command
        # torque went off by a rule of the session or was refused; until OFF
        self._locked = False
        # of the last ramp, or None: torque went off otherwise
        self._off: TorqueOff | None = None
        self._last_step: int | None = None
        # s, the last between two steps that was long enough for a bus watchdog
        self._pause = 0.0
        self._last_query: int | None = None
        self._durations: deque[float] = deque(maxlen=DURATIONS)

    def configure(self) -> tuple[str, ...]:
        """Open the port, check every servo, and switch off torque left on by a killed driver.

        Returns a line for each servo. Raises PortError, RefusedError.
        """
        found = self.bus.configure()
        off = self.bus.torque_off()
        if not off.complete:
            raise RefusedError(list(off.reasons))
        return found

    def start(self) -> None:
        """Torque on without motion, if the supervisor permits HOLD or PASS and still runs.

        Raises RefusedError with all torque off.
        """
        self._require_permission()
        try:
            self.bus.activate()
        except RefusedError as error:
            self.action, self.reason = Action.OFF, f"torque refused: {error}"
            self._locked = True
            raise
        self.watchdog.engage(self.bus.goals())
        self._last_step, self._pause = None, 0.0
        self.action, self.reason = Action.HOLD, "torque comes on"

    def _require_permission(self) -> None:
        """Raise RefusedError unless the supervisor permits torque, and lately."""
        limits, permission = self.watchdog.limits, self.watchdog.permission
        if limits is None:
            raise RefusedError([NO_LIMITS])
        if permission is None or permission.action not in STARTS:
            raise RefusedError(["the supervisor does not permit it"])
        age = self.bus.clock() - to_seconds(permission.time)
        if age > limits.command_hold:
            raise RefusedError(
                [f"the supervisor's permission is {age:.2f} s old"]
            )

    def offer(
        self, now: int, stamp: int, angle: Array, rate: Array = AT_REST
    ) -> str:
        """Accept angles (4,), rad, with their `stamp` and rate (4,), rad/s; or return why not."""
        fault = self.watchdog.offer(now, angle, rate)
        if not fault:
            self._offered = stamp
        return fault

    def permit(self, permission: Permission) -> None:
        """Store the supervisor's permission; OFF switches torque off at once."""
        self.watchdog.permit(permission)
        if permission.action is not Action.OFF:
            return
        if self.bus.active:
            self._switch_off(permission.reason)
        else:
            self.reason = permission.reason
        self._locked = False

    def may_start(self, permission: Permission) -> bool:
        """Whether a permission switches torque on; not after a RELAX or a refusal, until OFF."""
        return (
            permission.action in STARTS
            and self.watchdog.limits is not None
            and not (self.bus.active or self._locked)
        )

    def step(self, now: int) -> Cycle:
        """One bus cycle; raises PortError if the port has disappeared."""
        pause = (
            0.0
            if self._last_step is None
            else to_seconds(now - self._last_step)
        )
        self.overruns += pause > LATE * self.period
        if pause > self.bus.facts.watchdog:
            self._pause = pause
        self._last_step = now
        if self.bus.active:
            self._command(now)
        cycle = self.bus.cycle()
        self._durations.append(cycle.duration)
        if self.action is Action.PASS and self.commanded != self._offered:
            self.commanded, self.written = self._offered, cycle.written
        return cycle

    def _command(self, now: int) -> None:
        """Step the watchdog, and give its goals to the bus."""
        late = ""  # the bus cycle before, which has tripped a bus watchdog
        if self._pause and any(servo.stopped for servo in self.bus.health):
            late = f" after {self._pause:.2f} s without a bus cycle"
        for fault in [*self.faults(), *self.silent().values()][:1]:
            self.watchdog.relax(fault + late)
        goals = self.watchdog.step(now)
        self.action, self.reason = self.watchdog.action, self.watchdog.reason
        self._slewed = goals.slewed
        if not goals.torque:
            self._switch_off(self.reason)
            self._locked = bool(self.watchdog.own_reason)
        elif goals.action is not Action.HOLD or self.watchdog.eases:
            # goals that stay may be below the range of commands
            self.bus.command(goals.angle)

    def stop(self) -> TorqueOff:
        """Ramp the tendons to slack, then torque off, read back; blocks during the ramp.

        Torque is switched off even if an exception is raised meanwhile.
        """
        self.watchdog.relax("stopped")
        self._off = None
        try:
            while self.bus.active:
                self.step(to_ns(self.bus.clock()))
                self._sleep(self.period)
        except ServoError:
            pass  # torque goes off without a ramp
        finally:
            off = self._off or self.bus.torque_off()
        if self.action is not Action.OFF:
            self.action, self.reason = Action.OFF, "stopped"
        return off

    def pace(self, now: int) -> BusPace:
        """Rate and duration of the bus cycles since the last call."""
        times = list(self._durations)
        self._durations.clear()
        passed = (
            0.0
            if self._last_query is None
            else to_seconds(now - self._last_query)
        )
        self._last_query = now
        if not times or passed <= 0.0:
            return BusPace(0.0, 0.0, 0.0, self.overruns)
        return BusPace(
            len(times) / passed,
            sum(times) / len(times),
            max(times),
            self.overruns,
        )

    @property
    def urgent(self) -> tuple[Any, ...]:
        """Values of the health report whose change is published at once."""
        states = tuple(
            (servo.torque, servo.hardware_error) for servo in self.bus.health
        )
        return self.action, self.commanded, states, self._slewed.tobytes()

    def health(self, stamp: int) -> ServoHealth:
        """Health report of the servos at `stamp` (ns of the messages' clock)."""
        servos, now = self.bus.health, self.bus.clock()
        return ServoHealth(
            action=self.action,
            reason=self.reason,
            torque=np.array([bool(servo.torque) for servo in servos]),
            silence=np.array([servo.silence(now) for servo in servos]),
            goal=self.bus.goals(),
            slewed=self._slewed,
            hardware_error=np.array(
                [servo.hardware_error or 0 for servo in servos]
            ),
            temperature=_known(servos, "temperature"),
            voltage=self.voltage,
            error_rate=np.array([servo.error_rate for servo in servos]),
            commanded=self.commanded,
            written=(
                stamp - to_ns(now - self.written) if self.commanded else 0
            ),
            supervised=self.watchdog.supervised,
        )

    @property
    def voltage(self) -> Array:
        """Supply voltages (4,) that the servos have measured last, V; NaN: not read yet."""
        return _known(self.bus.health, "voltage")

    def faults(self) -> list[str]:
        """Faults of the servos, one line each."""
        return [
            line
            for servo in self.bus.health
            for line in servo.faults(self.bus.active)
        ]

    def silent(self) -> dict[str, str]:
        """Servos that have not answered for too long: one line each, by leg."""
        limits, now = self.watchdog.limits, self.bus.clock()
        limit = math.inf if limits is None else limits.servo_silent
        return {
            servo.leg: f"{servo.name}: no answer for {servo.silence(now):.2f} s, limit {limit:g} s"
            for servo in self.bus.health
            if servo.silence(now) > limit
        }

    def _switch_off(self, reason: str) -> None:
        """Torque off at once, with its confirmation in `reason`."""
        off = self._off = self.bus.torque_off()
        result = (
            "torque off"
            if off.complete
            else "torque NOT off: " + "; ".join(off.reasons)
        )
        self.action, self.reason = Action.OFF, f"{result}, after: {reason}"


def _known(servos: tuple[ServoStatus, ...], name: str) -> Array:
    """(4,) values of a field; NaN where it has not been read yet."""
    return np.array([getattr(servo, name) for servo in servos], dtype=float)
