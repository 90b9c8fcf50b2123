"""Conditions that forbid motion, from the newest inputs.

Times are on a clock that never goes back, ns. A source that never reported has infinite age.
"""

import math
from collections.abc import Iterable, Iterator

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import to_ns, to_seconds
from slot_core.control.policy import Status
from slot_core.estimation.estimate import USABLE, Estimate, Validity
from slot_core.faults import hardware_errors
from slot_core.robot import LEGS
from slot_core.safety.settings import SupervisorSettings
from slot_core.safety.states import Action, Condition
from slot_core.safety.watchdog import ServoHealth

Finding = tuple[Condition, str]
NO_REPORT = ServoHealth(
    action=Action.HOLD,
    reason="",
    torque=np.zeros(len(LEGS), dtype=np.bool_),
    goal=np.full(len(LEGS), math.inf),
)


class EmergencyStop:
    """The e-stop: it is pressed until every source that has pressed it has released it.

    A source is a terminal or a button, told apart by its name. It repeats its state, so that its
    loss is noticed. A source that is lost while pressed stays pressed until an operator says that
    it is gone. A source that is lost while released counts as lost until it is back, or until a
    reset with another source alive.
    """

    def __init__(self, limit: float, required: bool) -> None:
        """`limit`: longest time between two messages of a source, s; `required`: as a setting."""
        self._limit, self._required = limit, required
        # by name: time of the last message, ns, and whether it said pressed
        self._sources: dict[str, tuple[int, bool]] = {}

    def receive(
        self, time: int, source: str, pressed: bool, leaving: bool = False
    ) -> None:
        """State of a source; a source that is `leaving` is not missed, unless it is pressed."""
        if leaving and not pressed:
            self._sources.pop(source, None)
        else:
            self._sources[source] = time, pressed

    def pressed(self, time: int) -> str:
        """The pressed sources in one line, or ""."""
        silent = self._silent(time)
        names = [
            f"{name} (silent for {silent[name]:.3g} s)"
            if name in silent
            else name
            for name, (_, pressed) in self._sources.items()
            if pressed
        ]
        return f"e-stop pressed at {', '.join(names)}" if names else ""

    def lost(self, time: int) -> str:
        """The released sources that are silent in one line, or that there is none, or ""."""
        if self._required and not self._sources:
            return "no source of the e-stop"
        lost = [
            f"{name} silent for {age:.3g} s"
            for name, age in self._silent(time).items()
            if not self._sources[name][1]
        ]
        return (
            f"e-stop source {', '.join(lost)}, limit {self._limit:g} s"
            if lost
            else ""
        )

    def accept_losses(self, time: int) -> None:
        """Miss released sources that are silent no more, if another source is alive."""
        silent = self._silent(time)
        if len(silent) < len(self._sources):
            self._sources = {
                name: source
                for name, source in self._sources.items()
                if source[1] or name not in silent
            }

    def forget(self, time: int, source: str) -> str:
        """Release the e-stop of a silent source and forget it; returns the reason of a refusal."""
        if source not in self._sources:
            known = ", ".join(self._sources) or "none"
            return f"{source}: no source of the e-stop; known: {known}"
        if source not in self._silent(time):
            return f"{source} still sends: release it there"
        del self._sources[source]
        return ""

    def _silent(self, time: int) -> dict[str, float]:
        """Time since the last message of each source that is silent, s."""
        return {
            name: age
            for name, (received, _) in self._sources.items()
            if (age := to_seconds(time - received)) > self._limit
        }


class Conditions:
    """Newest value of every input, and the conditions that follow from them."""

    def __init__(self, settings: SupervisorSettings):
        self._settings = settings
        self._received: dict[str, int] = {}
        self.emergency_stop = EmergencyStop(
            settings.timing.estop, settings.estop_required
        )
        self._missed = 0  # unusable estimates in a row
        self._imu_missing: int | None = None  # since when
        self._usable = False  # whether there has been a usable estimate
        self.legs_are_known = True  # see Estimate
        self._message = ""  # of the newest estimate
        self._tilt: tuple[float, float] = (0.0, 0.0)  # rad, roll and pitch
        self.place_is_known = self.tilt_is_known = True
        self._stopped = ""  # why the MPC counts as stopped
        self._rejected = ""  # why the newest command was rejected
        self.intruder = ""  # topic of the controller and nodes that publish it
        # time of the last answer
        self._answered: list[int | None] = [None] * len(LEGS)
        self._not_finite: list[int | None] = [None] * len(LEGS)  # since when
        self._health = NO_REPORT
        self._reported = 0  # time of the last health report

    def receive_heartbeat(self, time: int, source: str) -> None:
        """A message of a node."""
        self._received[f"node {source}"] = time

    def receive_estimate(self, time: int, estimate: Estimate) -> None:
        """State of the torso; an estimate that is not finite is unusable."""
        self._received["estimate"] = time
        finite = bool(np.isfinite(estimate.state).all())
        usable = finite and estimate.validity in USABLE
        self._missed = 0 if usable else self._missed + 1
        self._usable = self._usable or usable
        self.legs_are_known = estimate.legs_are_known
        self._message = estimate.message
        if estimate.validity is Validity.VALID:
            self._imu_missing = None
        elif (
            estimate.validity is Validity.IMU_MISSING
            and self._imu_missing is None
        ):
            self._imu_missing = time
        limits, deviation = (
            self._settings.estimate,
            np.sqrt(estimate.covariance.diagonal()),
        )
        self.place_is_known = bool(deviation[3:5].max() <= limits.place_error)
        self.tilt_is_known = bool(deviation[:2].max() <= limits.tilt_error)
        if finite:
            self._tilt = (float(estimate.state[0]), float(estimate.state[1]))

    def receive_mpc(self, status: int, fallback_cycles: int) -> None:
        """Status of the last cycle of the MPC, and cycles since its last solution."""
        self._stopped = (
            f"MPC stopped, {fallback_cycles} cycles without a solution"
            if status == Status.STOPPED
            else ""
        )

    def receive_command(self, time: int, fault: str) -> None:
        """A command; `fault`: why it was rejected, or ""."""
        self._rejected = fault
        if not fault:
            self._received["command"] = time

    def receive_joints(self, time: int, angle: Array, torque: Array) -> None:
        """Measured angles and torques of the servos; values that are not finite are ignored."""
        for leg, finite in enumerate(np.isfinite(angle) & np.isfinite(torque)):
            if finite:
                self._answered[leg], self._not_finite[leg] = time, None
            elif self._not_finite[leg] is None:
                self._not_finite[leg] = time

    def receive_health(self, time: int, health: ServoHealth) -> None:
        """Health of the servos; a silence that is not finite means: the servo never answered."""
        self._health, self._reported = health, time
        for leg, silence in enumerate(health.silence):
            known = math.isfinite(silence) and silence >= 0.0
            self._answered[leg] = time - to_ns(silence) if known else None

    def unpowered(self) -> list[str]:
        """Servos without torque, one line each."""
        if self._health is NO_REPORT:
            return ["no report of the servos yet"]
        return [
            f"servo {leg} without torque"
            for leg, on in zip(LEGS, self._health.torque)
            if not on
        ]

    @property
    def supervised(self) -> int | None:
        """As of ServoHealth; None without a report."""
        return None if self._health is NO_REPORT else self._health.supervised

    def release_reason(self) -> str:
        """Reason of a RELAX or OFF that the servos report, or ""."""
        is_released = self._health.action in (Action.RELAX, Action.OFF)
        return f"servos: {self._health.reason}" if is_released else ""

    def torque_off(self, since: int) -> bool:
        """Whether a report newer than `since` says that no servo is under torque."""
        return (
            self._reported > since
            and self._health.action in (Action.RELAX, Action.OFF)
            and not self._health.torque.any()
        )

    def distance(self, angle: Array) -> float:
        """Largest distance of the servos' goals from angles (4,), rad; inf without a report."""
        return float(np.abs(self._health.goal - angle).max())

    def unwatched(self) -> Iterator[str]:
        """One line for each watch that is off, and why."""
        if not self.place_is_known:
            yield "no watch of motion and tendons: the place is not known"
        if not self.tilt_is_known:
            yield "no watch of the tilt: it is not known"
        elif self._settings.bench:
            yield "no watch of the tilt: the robot hangs on a bench"

    def sensor_warning(self, time: int) -> str:
        """One line on what the estimator compensates or misses, or ""."""
        if self._imu_missing is None:
            return self._message if self._missed == 0 else ""
        limit = self._settings.estimate.imu_silence
        age = to_seconds(time - self._imu_missing)
        line = f"no usable IMU for {age:.3g} s, limit {limit:g} s{self._why}"
        return line if age > limit else ""

    @property
    def _why(self) -> str:
        """Message of the newest estimate behind a colon, or ""."""
        return f": {self._message}" if self._message else ""

    @property
    def slewed(self) -> bool:
        """Whether the rate limit holds a goal back."""
        return bool(self._health.slewed.any())

    def conditions(self, time: int) -> dict[Condition, str]:
        """Every condition that holds now, with one line: cause, value and limit."""
        found: dict[Condition, str] = {}
        for check in (
            self._estop,
            self._servos,
            self._torso,
            self._nodes,
            self._commands,
        ):
            for condition, reason in check(time):
                found.setdefault(condition, reason)
        return found

    def _age(self, time: int, source: str) -> float:
        """Seconds since the last message of `source`."""
        received = self._received.get(source)
        return math.inf if received is None else to_seconds(time - received)

    def _estop(self, time: int) -> Iterator[Finding]:
        if reason := self.emergency_stop.pressed(time):
            yield Condition.ESTOP_PRESSED, reason
        if reason := self.emergency_stop.lost(time):
            yield Condition.ESTOP_LOST, reason

    def _servos(self, time: int) -> Iterator[Finding]:
        limit = self._settings.timing.servo_silent
        errors = [
            f"servo {leg}: {hardware_errors(bits)} error, register 70 = 0x{bits:02x}, limit 0"
            for leg, bits in zip(LEGS, self._health.hardware_error.tolist())
            if bits
        ]
        if errors:
            yield Condition.SERVO_FAULT, "; ".join(errors)
        for leg, answered, since in zip(LEGS, self._answered, self._not_finite):
            age = math.inf if answered is None else to_seconds(time - answered)
            if since is not None:
                age = max(age, to_seconds(time - since))
            if age > limit:
                yield (
                    Condition.SERVO_SILENT,
                    f"servo {leg} silent {_span(age)}, limit {limit:g} s",
                )

    def _torso(self, time: int) -> Iterator[Finding]:
        limits = self._settings.estimate
        watched = self.tilt_is_known and not self._settings.bench
        for name, angle in zip(("roll", "pitch"), self._tilt):
            if watched and abs(angle) > limits.tilt_max:
                yield (
                    Condition.TILTED,
                    f"{name} {angle:+.3f} rad, limit {limits.tilt_max:g} rad",
                )
        age, limit = self._age(time, "estimate"), limits.silence
        if math.isinf(age):
            yield (
                Condition.ESTIMATE_LOST,
                "no estimate yet: state_estimator waits for /odom and /imu",
            )
        if not self._usable:
            yield Condition.ESTIMATE_LOST, f"no usable estimate yet{self._why}"
        if self._missed > limits.coast_cycles:
            yield (
                Condition.ESTIMATE_LOST,
                f"{self._missed} estimates in a row unusable, limit {limits.coast_cycles}{self._why}",
            )
        if age > limit:
            yield (
                Condition.ESTIMATE_LOST,
                f"no estimate {_span(age)}, limit {limit:.3g} s",
            )

    def _nodes(self, time: int) -> Iterator[Finding]:
        if self.intruder:
            yield Condition.SECOND_PUBLISHER, self.intruder
        limit = self._settings.timing.heartbeat
        for node in self._settings.nodes:
            age = self._age(time, f"node {node}")
            if age > limit:
                yield (
                    Condition.NODE_LOST,
                    f"node {node} silent {_span(age)}, limit {limit:g} s",
                )

    def _commands(self, time: int) -> Iterator[Finding]:
        timing, age = self._settings.timing, self._age(time, "command")
        if self._stopped:
            yield Condition.MPC_STOPPED, self._stopped
        if self._rejected:
            yield Condition.COMMAND_REJECTED, self._rejected
        for condition, limit in (
            (Condition.COMMAND_LOST, timing.command_lost),
            (Condition.COMMAND_STALE, timing.command_hold),
        ):
            if age > limit:
                yield condition, f"no command {_span(age)}, limit {limit:g} s"


def _span(age: float) -> str:
    """Time since the last message, in words."""
    return "since the start" if math.isinf(age) else f"for {age:.3g} s"


class OptionalNodes:
    """Optional nodes such as recorder and viewer: the robot keeps walking when one ends.

    The supervisor reports the end. Its node looks for them among the nodes that ROS has discovered.
    So their end is noticed whatever has started them, and needs no message of theirs. A node that
    leaves the graph is missing at once; one that was killed stays listed until its lease ends (20 s
    with Fast DDS).
    """

    def __init__(self, names: Iterable[str]) -> None:
        self._names = frozenset(names)
        self._seen: set[str] = set()
        self._gone: list[str] = []

    def look(self, present: Iterable[str]) -> None:
        """Take the names of all nodes that are present."""
        found = self._names.intersection(present)
        self._gone = sorted(self._seen - found)
        self._seen |= found

    @property
    def warnings(self) -> list[str]:
        """One line for each that is gone."""
        return [
            f"node {name} has ended; the robot goes on without it"
            for name in self._gone
        ]
