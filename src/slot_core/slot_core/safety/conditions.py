"""What the supervisor hears of the robot, and what of it speaks against motion.

Times are those of a clock that never goes back, ns. What was never heard is as old as time.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from slot_core.clock import SECOND
from slot_core.control.mpc.mpc import Status
from slot_core.control.state_estimator import Estimate, Validity
from slot_core.robot import LEGS, Array
from slot_core.safety.command_gate import Action
from slot_core.safety.servo_health import ServoHealth
from slot_core.safety.settings import SupervisorSettings
from slot_core.safety.states import Condition

# Bits of register 70 of the XL430-W250, Hardware Error Status.
HARDWARE_ERRORS = {
    0: "input voltage",
    2: "overheating",
    3: "motor encoder",
    4: "electrical shock",
    5: "overload",
}
USABLE = (Validity.VALID, Validity.IMU_MISSING)

Finding = tuple[Condition, str]


class VitalSigns:
    """The newest of every input, and the conditions that follow from it."""

    def __init__(self, settings: SupervisorSettings):
        self._settings = settings
        self._heard: dict[str, int] = {}
        self._pressed = False
        self._missed = 0  # unusable estimates in a row
        self._usable = False  # whether there was a usable estimate
        self._tilt: tuple[float, float] = (0.0, 0.0)  # rad, roll and pitch
        self._stopped = ""  # why the solver counts as stopped
        self._rejected = ""  # why the newest command was refused
        self._answered: list[int | None] = [None] * len(LEGS)
        self._health: ServoHealth | None = None  # stays so where no driver is

    def hear(self, time: int, source: str) -> None:
        """A sign of life of a node."""
        self._heard[f"node {source}"] = time

    def see_estop(self, time: int, pressed: bool) -> None:
        """The state of the e-stop, from a source that reports it all the time."""
        self._heard["e-stop"], self._pressed = time, pressed

    def see_estimate(self, time: int, estimate: Estimate) -> None:
        """The torso's state; an estimate that is not finite is as good as none."""
        self._heard["estimate"] = time
        finite = bool(np.isfinite(estimate.state).all())
        usable = finite and estimate.validity in USABLE
        self._missed = 0 if usable else self._missed + 1
        self._usable = self._usable or usable
        if finite:
            self._tilt = (float(estimate.state[0]), float(estimate.state[1]))

    def see_solver(self, status: int, fallback_cycles: int) -> None:
        """How the last cycle of the MPC ended."""
        most = self._settings.solver.fallback_cycles
        self._stopped = ""
        if fallback_cycles > most:
            self._stopped = f"no solution for {fallback_cycles} cycles, limit {most}"
        elif status == Status.STOPPED:
            self._stopped = f"MPC stopped, {fallback_cycles} cycles without a solution"

    def see_command(self, time: int, fault: str) -> None:
        """A vector of commands, and why it was refused, or ""."""
        self._rejected = fault
        if not fault:
            self._heard["command"] = time

    def see_joints(self, time: int, angle: Array, torque: Array) -> None:
        """A measurement of the servos; one that is not finite is none."""
        for leg in np.flatnonzero(np.isfinite(angle) & np.isfinite(torque)):
            self._answered[leg] = time

    def see_health(self, time: int, health: ServoHealth) -> None:
        """What the driver says; of a silence that is no time a servo never answered."""
        self._health = health
        for leg, silence in enumerate(health.silence):
            known = math.isfinite(silence) and silence >= 0.0
            self._answered[leg] = time - round(silence * SECOND) if known else None

    def unpowered(self) -> list[str]:
        """Servos that are not under torque, as far as a driver says so, one line each."""
        if self._health is None:
            return []
        return [
            f"servo {leg} without torque" for leg, on in zip(LEGS, self._health.torque) if not on
        ]

    def released(self) -> str:
        """Why the driver keeps the legs slack or makes them so, or ""."""
        if self._health is None or self._health.action in (Action.PASS, Action.HOLD):
            return ""
        return f"driver: {self._health.reason}"

    def conditions(self, time: int) -> dict[Condition, str]:
        """Each condition that holds, with one line: what, value and limit."""
        found: dict[Condition, str] = {}
        for look in (self._estop, self._servos, self._torso, self._nodes, self._commands):
            for condition, reason in look(time):
                found.setdefault(condition, reason)
        return found

    def _age(self, time: int, source: str) -> float:
        """Seconds since `source` was heard."""
        heard = self._heard.get(source)
        return math.inf if heard is None else (time - heard) / SECOND

    def _estop(self, time: int) -> Iterator[Finding]:
        limit = self._settings.timing.estop
        age = self._age(time, "e-stop")
        if self._pressed:
            yield Condition.ESTOP_PRESSED, "e-stop pressed"
        if age > limit and (self._settings.estop_required or age < math.inf):
            yield Condition.ESTOP_LOST, f"e-stop source silent for {_span(age)}, limit {limit:g} s"

    def _servos(self, time: int) -> Iterator[Finding]:
        limit = self._settings.timing.servo_silent
        if errors := list(self._hardware_errors()):
            yield Condition.SERVO_FAULT, "; ".join(errors)
        for leg, answered in zip(LEGS, self._answered):
            age = math.inf if answered is None else (time - answered) / SECOND
            if age > limit:
                yield (
                    Condition.SERVO_SILENT,
                    f"servo {leg} silent for {_span(age)}, limit {limit:g} s",
                )

    def _torso(self, time: int) -> Iterator[Finding]:
        limits = self._settings.estimate
        for name, angle in zip(("roll", "pitch"), self._tilt):
            if abs(angle) > limits.tilt_max:
                yield Condition.TILTED, f"{name} {angle:+.3f} rad, limit {limits.tilt_max:g} rad"
        if not self._usable:
            yield Condition.ESTIMATE_LOST, "no usable estimate yet"
        if self._missed > limits.coast_cycles:
            yield (
                Condition.ESTIMATE_LOST,
                f"{self._missed} estimates in a row unusable, limit {limits.coast_cycles}",
            )
        age, limit = self._age(time, "estimate"), (limits.coast_cycles + 1) * limits.period
        if age > limit:
            yield Condition.ESTIMATE_LOST, f"no estimate for {_span(age)}, limit {limit:.3g} s"

    def _nodes(self, time: int) -> Iterator[Finding]:
        limit = self._settings.timing.heartbeat
        for node in self._settings.nodes:
            age = self._age(time, f"node {node}")
            if age > limit:
                yield Condition.NODE_LOST, f"node {node} silent for {_span(age)}, limit {limit:g} s"

    def _commands(self, time: int) -> Iterator[Finding]:
        timing, age = self._settings.timing, self._age(time, "command")
        if self._stopped:
            yield Condition.SOLVER_STOPPED, self._stopped
        if self._rejected:
            yield Condition.COMMAND_REJECTED, self._rejected
        for condition, limit in (
            (Condition.COMMAND_LOST, timing.command_lost),
            (Condition.COMMAND_STALE, timing.command_hold),
        ):
            if age > limit:
                yield condition, f"no command for {_span(age)}, limit {limit:g} s"

    def _hardware_errors(self) -> Iterator[str]:
        """One line for each servo with error bits."""
        if self._health is None:
            return
        for leg, bits in zip(LEGS, map(int, self._health.hardware_error)):
            names = [HARDWARE_ERRORS.get(k, f"bit {k}") for k in range(8) if bits >> k & 1]
            if names:
                yield f"servo {leg}: {', '.join(names)} error, register 70 = 0x{bits:02x}, limit 0"


def _span(age: float) -> str:
    return "ever" if math.isinf(age) else f"{age:.3g} s"
