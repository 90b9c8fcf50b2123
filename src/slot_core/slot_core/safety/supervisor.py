"""The supervisor: what the robot may do, why, and what the servos are told.

States and transitions are data (`states.py`); what speaks against motion is found in
`conditions.py`, damaged tendons in `tendon_watch.py`; what goes out passes `command_gate.py`.
Every input and `step` carry the present time `now` (ns) of one clock, that of the messages' stamps.
Nothing raises for bad data: it is refused, and then missing.
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.clock import SECOND
from slot_core.control.state_estimator import Estimate
from slot_core.robot import LEGS, Array, Robot
from slot_core.safety.command_gate import CommandGate, Gated
from slot_core.safety.conditions import VitalSigns
from slot_core.safety.servo_health import ServoHealth
from slot_core.safety.settings import SupervisorSettings
from slot_core.safety.states import (
    ACTIONS,
    FAULTS,
    HARD_FAULTS,
    REASONS_TO_HOLD,
    Condition,
    State,
    next_state,
)
from slot_core.safety.tendon_watch import TendonReport, TendonWatch

MOVING = (State.STANDING, State.WALKING)
UNDER_TORQUE = (State.READY, *MOVING, State.HOLD)


class Request(enum.Enum):
    """What an operator may ask for."""

    READY = Condition.READY_REQUESTED
    STAND = Condition.STAND_REQUESTED
    WALK = Condition.WALK_REQUESTED
    RELAX = Condition.RELAX_REQUESTED
    RESET = Condition.RESET_REQUESTED
    ESTOP = Condition.ESTOP_PRESSED


_TO_RESET = frozenset({Condition.ESTOP_PRESSED, Condition.ESTOP_LOST, Condition.SERVO_FAULT})
_TO_READY = _TO_RESET | {Condition.SERVO_SILENT, Condition.TILTED}
_TO_MOVE = _TO_READY | REASONS_TO_HOLD | {Condition.COMMAND_LOST}
OBSTACLES: dict[Request, frozenset[Condition]] = {
    Request.READY: _TO_READY,
    Request.STAND: _TO_MOVE,
    Request.WALK: _TO_MOVE,
    Request.RELAX: frozenset(),
    Request.RESET: _TO_RESET,
    Request.ESTOP: frozenset(),
}


@dataclass(frozen=True)
class Report:
    """What `step` gives: to be published, and to be obeyed."""

    state: State
    reason: str  # of the last transition, one line with value and limit
    since: int  # ns of `now` at the last transition
    warnings: tuple[str, ...]  # what speaks against motion now, one line each
    command: Gated
    slack: Array  # (4,) m, of the tendons beside the usual; NaN where not known


class SteadyClock:
    """Time that never goes back: a jump of the clock counts as no time at all."""

    def __init__(self, jump: float):
        self._jump = round(jump * SECOND)
        self._last: int | None = None
        self._time = 0
        self.jumped = ""  # one line on the last jump, until it is cleared

    def advance(self, now: int) -> int:
        """Steady time at `now`, both ns."""
        passed = 0 if self._last is None else now - self._last
        self._last = now
        if abs(passed) > self._jump:
            self.jumped = f"clock jumped by {passed / SECOND:+.3g} s, limit {self._jump / SECOND:g}"
            passed = 0
        self._time += max(passed, 0)
        return self._time


class Supervisor:
    """The state machine with its inputs `see_...`, `hear` and `request`, and its output `step`."""

    def __init__(self, robot: Robot, settings: SupervisorSettings, watch: TendonWatch):
        """Raises ConfigError as `CommandGate` does."""
        self._robot, self._settings, self._watch = robot, settings, watch
        self._signs = VitalSigns(settings)
        self._gate = CommandGate(settings.gate, robot.tendon.angle_max)
        self._clock = SteadyClock(settings.timing.clock_jump)
        self._newest: dict[str, int] = {}  # ns, stamp of each input
        self._misfits: dict[str, str] = {}  # inputs whose last stamp was of another clock
        self._state, self._reason, self._since = State.IDLE, "started", 0
        self._resume = State.STANDING  # where HOLD leads back to
        self._entered = 0  # steady time of the last transition
        self._powered = 0  # steady time of the last READY
        self._clear: int | None = None  # steady time since when nothing speaks for HOLD
        self._faulty = False  # whether RELAX ends in FAULT
        self._servo_angle = np.full(len(LEGS), np.nan)
        self._height = np.full(len(LEGS), np.nan)  # m, of the clamps
        self._seen = 0  # steady time of the estimate that they are from
        self._stride = settings.tendon.window_min  # s
        self._tendons: TendonReport = watch.state

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    def hear(self, now: int, node: str) -> None:
        """A sign of life of one of `settings.nodes`."""
        self._signs.hear(self._pass(now), node)

    def see_estop(self, now: int, pressed: bool) -> None:
        """The state of the e-stop; its source has to repeat it within `timing.estop`."""
        self._signs.see_estop(self._pass(now), pressed)

    def see_gait(self, now: int, stride: float) -> None:
        """Period of the present gait, s."""
        self._pass(now)
        if np.isfinite(stride) and stride > 0.0:
            self._stride = float(stride)

    def see_solver(self, now: int, status: int, fallback_cycles: int) -> None:
        """How a cycle of the MPC ended: `mpc.Status` and the cycles since the last solution."""
        self._pass(now)
        self._signs.see_solver(status, fallback_cycles)

    def see_estimate(self, now: int, estimate: Estimate) -> None:
        """An estimate of the torso's state, usable or not."""
        time = self._pass(now)
        if self._refuse("estimate", now, estimate.stamp):
            return
        self._signs.see_estimate(time, estimate)
        self._height, self._seen = self._clamp_heights(estimate.state), time

    def see_command(self, now: int, stamp: int, angle: Array) -> str:
        """Tendon angles (4,), rad, of the controller; returns why they are refused, or ""."""
        time = self._pass(now)
        if fault := self._refuse("command", now, stamp):
            return fault
        fault = self._gate.offer(angle)
        self._signs.see_command(time, fault)
        return fault

    def see_joints(self, now: int, stamp: int, angle: Array, torque: Array) -> None:
        """Tendon angles (4,), rad, and the servos' torques on them (4,), N m, at `stamp`."""
        time = self._pass(now)
        if self._refuse("joints", now, stamp):
            return
        self._signs.see_joints(time - max(now - stamp, 0), angle, torque)
        self._servo_angle = np.array(angle, dtype=np.float64)
        if self._strides(time):
            self._tendons = self._watch.observe(stamp, angle, torque, self._height, self._stride)

    def see_health(self, now: int, stamp: int, health: ServoHealth) -> None:
        """What the driver says of its servos at `stamp`; not needed where no driver is."""
        time = self._pass(now)
        if not self._refuse("servo health", now, stamp):
            self._signs.see_health(time - max(now - stamp, 0), health)

    def request(self, now: int, request: Request, by: str = "the operator") -> str:
        """Ask for a transition, made at once; returns why it is refused, or "".

        STAND in HOLD is granted for the time after it: the robot will not walk on by itself.
        """
        time = self._pass(now)
        before, condition = self._state, request.value
        active = self._conditions(time)
        if request is Request.STAND and before is State.HOLD:
            self._resume = State.STANDING
            return ""
        if next_state(before, condition) is before:
            return (
                ""
                if self._is_there(request)
                else f"{request.name} changes nothing in {before.name}"
            )
        against = [text for c, text in active.items() if c in OBSTACLES[request]]
        if not against:
            against = self._hindrances(request)
        if against:
            return f"{request.name} refused in {before.name}: {against[0]}"
        self._go(now, time, condition, f"{condition.value} by {by}")
        return ""

    def step(self, now: int) -> Report:
        """Decide, and say what the servos are to do."""
        time = self._pass(now)
        active = self._conditions(time)
        self._clock.jumped = ""
        if self._state is State.RELAX and not HARD_FAULTS.isdisjoint(active):
            self._faulty = True
        for condition in Condition:
            if condition in active and next_state(self._state, condition) is not self._state:
                self._go(now, time, condition, active[condition])
                break
        walking = self._state is State.WALKING
        gated = self._gate.step(time, ACTIONS[self._state], fast=walking)
        warnings = [text for c, text in active.items() if c in REASONS_TO_HOLD | FAULTS]
        warnings += self._misfits.values()
        if walking and gated.slewed.any():
            warnings.append(f"command slewed, {self._gate.distance:.3g} rad left")
        return Report(
            self._state, self._reason, self._since, tuple(warnings), gated, self._tendons.slack
        )

    def _pass(self, now: int) -> int:
        """Steady time; after a jump all stamps are new."""
        time = self._clock.advance(now)
        self._since = self._since or now
        if self._clock.jumped:
            self._newest.clear()
        return time

    def _refuse(self, source: str, now: int, stamp: int) -> str:
        """Why a stamp cannot be: of another clock, or not newer than the last; or ""."""
        limit = self._settings.timing.clock_jump
        off = (stamp - now) / SECOND
        if abs(off) > limit:
            self._misfits[source] = f"{source} stamped {off:+.3g} s from now, limit {limit:g} s"
            return self._misfits[source]
        self._misfits.pop(source, None)
        if stamp <= self._newest.get(source, stamp - 1):
            return f"{source} is not newer than the last"
        self._newest[source] = stamp
        return ""

    def _conditions(self, time: int) -> dict[Condition, str]:
        """Everything that holds now, with its reason."""
        found = self._signs.conditions(time)
        if self._clock.jumped:
            found[Condition.CLOCK_JUMPED] = self._clock.jumped
        if self._tendons.damaged.any():
            found[Condition.TENDON_DAMAGED] = self._tendons.message
        if reason := self._disobedience(time):
            found.setdefault(Condition.SERVO_FAULT, reason)
        if self._state is State.HOLD:
            self._weigh_hold(time, found)
        if self._state is State.RELAX and self._gate.relaxed:
            ending = Condition.RELAXED_AFTER_FAULT if self._faulty else Condition.RELAXED
            found[ending] = f"slack after: {self._reason}"
        return found

    def _strides(self, time: int) -> bool:
        """Whether the legs follow the gait and the torso's place is known.

        Not while they catch up after a HOLD, nor where estimates are missed.
        """
        moving = time - self._entered > self._settings.gate.resume_time * SECOND
        known = time - self._seen <= 2.0 * self._settings.estimate.period * SECOND
        return self._state in MOVING and moving and known

    def _disobedience(self, time: int) -> str:
        """Why the driver is slack though it has had time to switch torque on, or ""."""
        late = time - self._powered > self._settings.timing.obey * SECOND
        return self._signs.released() if self._state in UNDER_TORQUE and late else ""

    def _weigh_hold(self, time: int, found: dict[Condition, str]) -> None:
        """Add what ends HOLD."""
        timing = self._settings.timing
        held = (time - self._entered) / SECOND
        if held > timing.hold_max:
            why = f"held for {held:.3g} s, limit {timing.hold_max:g} s, since: {self._reason}"
            found[Condition.HELD_TOO_LONG] = why
        if not REASONS_TO_HOLD.isdisjoint(found):
            self._clear = None
            return
        self._clear = time if self._clear is None else self._clear
        if time - self._clear >= timing.recovery * SECOND:
            walked = self._resume is State.WALKING
            back = Condition.WALKING_RECOVERED if walked else Condition.STANDING_RECOVERED
            found[back] = f"nothing to hold for in {timing.recovery:g} s, after: {self._reason}"

    def _is_there(self, request: Request) -> bool:
        """Whether the robot is where `request` leads."""
        goals = {
            Request.READY: (State.READY,),
            Request.STAND: (State.STANDING,),
            Request.WALK: (State.WALKING,),
            Request.RELAX: (State.RELAX, State.IDLE, State.ESTOP, State.FAULT),
            Request.RESET: (State.IDLE,),
            Request.ESTOP: (State.ESTOP,),
        }
        return self._state in goals[request]

    def _hindrances(self, request: Request) -> list[str]:
        """What no condition says."""
        if request is Request.READY:
            return self._misplaced()
        if request is Request.STAND and (without := self._signs.unpowered()):
            return without
        limit, distance = self._settings.gate.arrived, self._gate.distance
        if request is Request.WALK and distance > limit:
            return [f"the legs are {distance:.3g} rad from their command, limit {limit:g} rad"]
        return []

    def _misplaced(self) -> list[str]:
        """Servos whose angle lies outside of the range: their zero is wrong."""
        most, slop = self._robot.tendon.angle_max, self._settings.servo.angle_tolerance
        return [
            f"servo {leg} at {angle:.3g} rad, limits [{-slop:.3g}, {most + slop:.3g}]"
            for leg, angle in zip(LEGS, self._servo_angle)
            if not -slop <= angle <= most + slop
        ]

    def _go(self, now: int, time: int, condition: Condition, reason: str) -> None:
        before, after = self._state, next_state(self._state, condition)
        self._state, self._reason, self._since = after, reason, now
        self._entered, self._clear = time, None
        if after is State.HOLD:
            self._resume = before
        elif after is State.READY:
            self._powered = time
            self._gate.engage(self._servo_angle)
            self._watch.reset()
            self._tendons = self._watch.state
        elif after is State.RELAX:
            self._faulty = condition in FAULTS
        elif after is State.WALKING:
            self._gate.hurry(time)

    def _clamp_heights(self, state: Array) -> Array:
        """(4,) m over the floor; NaN where the state is not finite."""
        if not np.isfinite(state).all():
            return np.full(len(LEGS), np.nan)
        clamps = Rotation.from_euler("xyz", state[0:3]).apply(self._robot.clamps)
        return state[5] + clamps[:, 2]
