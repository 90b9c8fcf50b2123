"""The supervisor: state of the robot, its reason, and the permission of the servos.

States and transitions are data (`states.py`). Conditions that forbid motion come from
`conditions.py`, damaged tendons from `tendon_watch.py`. Commands do not pass through here: the
driver and simulated servos check them and report back (`watchdog.py`).
Every input and `step` carry the present time `now` (ns) on the clock of the messages' stamps.
Bad data raise no exception: they are rejected, and then count as missing.
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import SECOND, to_ns, to_seconds
from slot_core.estimation.estimate import Estimate
from slot_core.legs.leg_table import legs_message
from slot_core.robot import LEGS, RobotParameters
from slot_core.safety.conditions import Conditions, OptionalNodes
from slot_core.safety.motion_watch import MotionWatch
from slot_core.safety.rate_limiter import AT_REST, command_fault
from slot_core.safety.settings import SupervisorSettings
from slot_core.safety.states import (
    ACTIONS,
    FAULTS,
    FORBIDDEN_BY,
    OPERATOR,
    REASONS_TO_HOLD,
    REASONS_TO_RELAX,
    REMARKS,
    Action,
    Condition,
    Request,
    State,
    next_state,
    no_change,
)
from slot_core.safety.tendon_watch import TendonReport, TendonWatch
from slot_core.safety.watchdog import ServoHealth

TOLD = 0.1  # of the legs' modulus: a smaller change is not told
PERIOD = 0.02  # s, between two steps without an urgent input
MOVING = (State.STANDING, State.WALKING)
UNDER_TORQUE = (State.READY, *MOVING, State.HOLD)


@dataclass(frozen=True)
class Report:
    """Result of a step, to be published."""

    state: State
    action: Action  # what the servos are permitted to do
    reason: str  # of the last transition, one line with value and limit
    since: int  # ns of `now` at the last transition
    # conditions that forbid motion now, one line each
    warnings: tuple[str, ...]
    slack: Array  # (4,) m, extra length of the tendons, inferred from the load; NaN: unknown
    # whether the last transition led from HOLD back to the state before it
    resumed: bool
    followed: bool  # whether the servos follow the commands, and have reached them once

    @property
    def keeps_gait(self) -> bool:
        """Whether gait and velocity stay as they were requested last: in HOLD and after it."""
        return self.state is State.HOLD or self.resumed


class SteadyClock:
    """Time that never goes back; a jump of the clock adds nothing to it."""

    def __init__(self, jump: float):
        self._jump, self._time = to_ns(jump), 0
        self._last: int | None = None
        self.jumped = ""  # one line on the last jump, until it is cleared

    def advance(self, now: int) -> int:
        """Steady time at `now`, both ns."""
        passed = 0 if self._last is None else now - self._last
        self._last = now
        if abs(passed) > self._jump:
            self.jumped = (
                f"clock jumped by {to_seconds(passed):+.3g} s, limit"
                f" {to_seconds(self._jump):g}"
            )
            passed = 0
        self._time += max(passed, 0)
        return self._time


class Supervisor:
    """State machine; inputs: `receive_...` and `request`, output: result of `step`."""

    def __init__(
        self,
        robot: RobotParameters,
        settings: SupervisorSettings,
        watch: TendonWatch,
    ):
        """Raises ConfigError when the ramp to slack takes longer than `gate.relax_time`."""
        settings.gate.check_ramp(robot.tendon.angle_max)
        self._robot, self._settings, self._watch = robot, settings, watch
        self._inputs = Conditions(settings)
        self._companions = OptionalNodes(settings.companions)
        self._motion = MotionWatch(settings.motion)
        self._clock = SteadyClock(settings.timing.clock_jump)
        self._newest: dict[str, int] = {}  # ns, stamp of each input
        self._wrong_clock: dict[
            str, str
        ] = {}  # faults of inputs stamped by another clock
        # inputs with a stamp of this clock since the fault
        self._right_clock: set[str] = set()
        self.operated = False  # whether an operator has requested anything
        self._state, self._reason, self._since = State.IDLE, "started", 0
        # state after HOLD; state before it
        self._resume = self._held_from = State.STANDING
        self._holds: list[int] = []  # steady times of the last HOLDs
        # whether the last transition led from HOLD back to it
        self._resumed = False
        # steady times of the last transition and of the last READY
        self._entered = self._ready_since = 0
        # steady time since which there is no reason to hold
        self._clear_since: int | None = None
        self._faulty = False  # whether RELAX ends in FAULT
        self._followed = False  # whether the servos follow the commands
        self._unfollowed = 0  # steady time when they did not, last
        self._command = np.zeros(len(LEGS))  # rad, last accepted
        # (3,) v_x, v_y m/s, yaw rate rad/s, commanded, in the heading frame
        self._velocity = np.zeros(3)
        self._tendon_angle = np.full(len(LEGS), np.nan)
        self._height = np.full(len(LEGS), np.nan)  # m, of the clamps
        self._stride = settings.tendon.window_min  # s
        self._leg_stiffness = 1.0  # of the newest estimate
        self._modulus = np.nan  # of the legs over the table's, as shown
        self._tendons: TendonReport = watch.state

    @property
    def state(self) -> State:
        """The present state."""
        return self._state

    @property
    def supervised(self) -> int | None:
        """Stamp of the first message of a supervisor that the servos took, ns; None: no report."""
        return self._inputs.supervised

    def receive_nodes(self, names: Iterable[str], intruder: str = "") -> None:
        """Names of the nodes that are there now; a line on a topic with too many publishers."""
        self._inputs.intruder = intruder
        self._companions.look(names)

    def receive_estop(
        self, now: int, source: str, pressed: bool, *, leaving: bool = False
    ) -> None:
        """State of a source of the e-stop, repeated within `timing.estop` unless it is leaving."""
        self._inputs.emergency_stop.receive(
            self._advance(now), source, pressed, leaving
        )

    def forget_estop(self, now: int, source: str) -> str:
        """Take a silent source of the e-stop for gone, pressed or not; or return why not."""
        return self._inputs.emergency_stop.forget(self._advance(now), source)

    def receive_mpc(
        self,
        now: int,
        status: int,
        fallback_cycles: int,
        stride: float,
        velocity: Array,
    ) -> None:
        """A message of the MPC's node, which is its heartbeat too.

        status: of a cycle (`mpc.Status`), with the cycles since the last solution. stride: period of
        the gait, s. velocity: (3,) commanded, v_x, v_y (m/s) and yaw rate (rad/s), heading frame.
        """
        self._inputs.receive_heartbeat(self._advance(now), "mpc_controller")
        self._inputs.receive_mpc(status, fallback_cycles)
        if np.isfinite(stride) and stride > 0.0:
            self._stride = float(stride)
        if np.isfinite(velocity).all():
            self._velocity = np.array(velocity, dtype=np.float64)

    def receive_estimate(self, now: int, estimate: Estimate) -> None:
        """Estimate of the torso's state, usable or not; heartbeat of the state estimator."""
        time = self._advance(now)
        self._inputs.receive_heartbeat(time, "state_estimator")
        if self._stamp_fault("estimate", now, estimate.stamp):
            return
        self._inputs.receive_estimate(time, estimate)
        known = self._inputs.place_is_known
        if known and self._state is State.WALKING and self._follows_gait(time):
            self._motion.observe(
                time, estimate.state, self._command, self._velocity
            )
        else:
            self._motion.pause()
        state, self._leg_stiffness = estimate.state, estimate.leg_stiffness
        self._height = np.full(len(LEGS), np.nan)
        # a slide loads the legs in other ways than their statics say
        if known and np.isfinite(state).all() and not self._motion.slides:
            self._height = self._robot.clamp_heights(state[5], *state[:2])

    def receive_command(
        self, now: int, stamp: int, angle: Array, rate: Array = AT_REST
    ) -> str:
        """Tendon angles (4,), rad, and their rate (4,), rad/s; heartbeat of the force mapper.

        Returns why the command is not accepted, or "".
        """
        time = self._advance(now)
        self._inputs.receive_heartbeat(time, "force_mapper")
        if fault := self._stamp_fault("command", now, stamp):
            return fault
        fault = command_fault(angle, rate, self._robot.tendon.angle_max)
        if not fault:
            self._command = np.array(angle, dtype=np.float64)
        self._inputs.receive_command(time, fault)
        return fault

    def receive_joints(
        self, now: int, stamp: int, angle: Array, torque: Array
    ) -> None:
        """Tendon angles (4,), rad, and the servos' torques on them (4,), N m, at `stamp`."""
        time = self._advance(now)
        if self._stamp_fault("joints", now, stamp):
            return
        self._inputs.receive_joints(time - max(now - stamp, 0), angle, torque)
        self._tendon_angle = np.array(angle, dtype=np.float64)
        if self._follows_gait(time):
            oldest = min(
                stamp,
                *(
                    self._newest.get(name, 0)
                    for name in ("estimate", "command")
                ),
            )
            self._tendons = self._watch.observe(
                stamp,
                angle,
                torque,
                self._height,
                self._stride,
                age=to_seconds(now - oldest),
            )

    def receive_health(self, now: int, stamp: int, health: ServoHealth) -> None:
        """Health of the servos at `stamp`, from the driver or from simulated servos."""
        time = self._advance(now)
        if not self._stamp_fault("servo health", now, stamp):
            self._inputs.receive_health(time - max(now - stamp, 0), health)

    def request(self, now: int, request: Request, by: str = OPERATOR) -> str:
        """Make a transition at once on request; returns why it is refused, or "".

        STAND in HOLD is granted and applies when HOLD ends: the robot then stands.
        RESET without torque accepts that released sources of the e-stop are lost.
        """
        time = self._advance(now)
        self.operated = self.operated or by == OPERATOR
        if request is Request.RESET and ACTIONS[self._state] is Action.OFF:
            self._inputs.emergency_stop.accept_losses(time)
        before, condition = self._state, request.value
        active = self._conditions(time)
        if request is Request.STAND and before is State.HOLD:
            self._resume = State.STANDING
            return ""
        if next_state(before, condition) is before:
            return no_change(request, before)
        reasons = [
            text for c, text in active.items() if c in FORBIDDEN_BY[request]
        ] or self._further_reasons(request)
        if reasons:
            return f"{request.name} refused in {before.name}: {reasons[0]}"
        self._transition(now, time, condition, f"{condition.value} by {by}")
        return ""

    def step(self, now: int) -> Report:
        """Make the transition that the present conditions call for, if any."""
        time = self._advance(now)
        active = self._conditions(time)
        self._clock.jumped = ""
        if self._state is State.RELAX and not FAULTS.isdisjoint(active):
            self._faulty = True
        for condition in Condition if active else ():
            if (
                condition in active
                and next_state(self._state, condition) is not self._state
            ):
                self._transition(now, time, condition, active[condition])
                break
        found = self._tendons.stiffness
        if not abs(found - self._modulus) <= TOLD:
            self._modulus = found
        lines = (
            self._inputs.sensor_warning(time),
            legs_message(self._leg_stiffness, self._modulus, self._robot.mass),
        )
        warnings = [
            *(
                text
                for c, text in active.items()
                if c in REASONS_TO_HOLD | REASONS_TO_RELAX | REMARKS
            ),
            *self._wrong_clock.values(),
            *self._companions.warnings,
            *filter(None, lines),
            *self._inputs.unwatched(),
        ]
        for (
            source
        ) in self._right_clock:  # not before a report has named the fault
            self._wrong_clock.pop(source, None)
        self._right_clock.clear()
        distance = self._inputs.distance(self._command)
        # from when the servos have reached the commands: before, at a limited rate, they are on
        # their way from wherever the legs were
        self._followed = ACTIONS[self._state] is Action.PASS and (
            self._followed or distance <= self._settings.arrived
        )
        if not self._followed:
            self._unfollowed = time
        elif self._inputs.slewed:
            warnings.append(f"command slewed, {distance:.3g} rad left")
        return Report(
            state=self._state,
            action=ACTIONS[self._state],
            reason=self._reason,
            since=self._since,
            warnings=tuple(warnings),
            slack=self._tendons.slack,
            resumed=self._resumed,
            followed=self._followed,
        )

    def _advance(self, now: int) -> int:
        """Steady time at `now`; after a jump every stamp counts as newer."""
        time = self._clock.advance(now)
        self._since = self._since or now
        if self._clock.jumped:
            self._newest.clear()
            self._watch.pause()
            self._tendons = self._watch.state
        return time

    def _stamp_fault(self, source: str, now: int, stamp: int) -> str:
        """Why a stamp is rejected: of another clock, or not newer than the last; or ""."""
        limit = self._settings.timing.clock_jump
        ahead = to_seconds(stamp - now)
        if abs(ahead) > limit:
            fault = (
                f"{source} stamped {ahead:+.3g} s from now, limit {limit:g} s"
            )
            self._wrong_clock[source] = fault
            self._right_clock.discard(source)
            return fault
        self._right_clock.add(source)
        if stamp <= self._newest.get(source, stamp - 1):
            return f"{source} is not newer than the last"
        self._newest[source] = stamp
        return ""

    def _conditions(self, time: int) -> dict[Condition, str]:
        """Every condition that holds now, with its reason."""
        found = self._inputs.conditions(time)
        if self._clock.jumped:
            found[Condition.CLOCK_JUMPED] = self._clock.jumped
        if self._tendons.damaged.any():
            found[Condition.TENDON_DAMAGED] = self._tendons.message
        found |= self._motion.findings
        change = self._settings.timing.torque_change * SECOND
        if (
            self._state in UNDER_TORQUE
            and time - self._ready_since > change
            and (reason := self._inputs.release_reason())  # without torque
        ):
            found.setdefault(Condition.SERVO_FAULT, reason)
        if self._state is State.HOLD:
            self._end_hold(time, found)
        if self._state is State.RELAX:
            self._end_relax(time, found)
        return found

    def _follows_gait(self, time: int) -> bool:
        """Whether the legs follow the gait: for `resume_time`, in the same state."""
        since = max(self._entered, self._unfollowed)
        return (
            self._state in MOVING
            and time - since > self._settings.gate.resume_time * SECOND
        )

    def _end_relax(self, time: int, found: dict[Condition, str]) -> None:
        """Add the condition that ends RELAX: torque off, as the servos report it.

        Without such a report RELAX ends in FAULT after `relax_time` and `torque_change`.
        """
        if self._inputs.torque_off(self._entered):
            found[
                Condition.RELAXED_AFTER_FAULT
                if self._faulty
                else Condition.RELAXED
            ] = f"slack after: {self._reason}"
            return
        limit = (
            self._settings.gate.relax_time + self._settings.timing.torque_change
        )
        if to_seconds(time - self._entered) > limit:
            found[Condition.RELAXED_AFTER_FAULT] = (
                f"torque off not confirmed within {limit:.3g} s, after: {self._reason}"
            )

    def _end_hold(self, time: int, found: dict[Condition, str]) -> None:
        """Add the condition that ends HOLD."""
        timing = self._settings.timing
        held = to_seconds(time - self._entered)
        if held > timing.hold_max:
            found[Condition.HELD_TOO_LONG] = (
                f"held for {held:.3g} s, limit {timing.hold_max:g} s, since: {self._reason}"
            )
        if len(self._holds) > timing.holds_max:
            found[Condition.HELD_TOO_OFTEN] = (
                f"held {len(self._holds)} times in {timing.holds_window:g} s,"
                f" limit {timing.holds_max}, at last for: {self._reason};"
                " mend that, then reset"
            )
        if not REASONS_TO_HOLD.isdisjoint(found):
            self._clear_since = None
            return
        self._clear_since = (
            time if self._clear_since is None else self._clear_since
        )
        if time - self._clear_since >= timing.recovery * SECOND:
            recovered = (
                Condition.WALKING_RECOVERED
                if self._resume is State.WALKING
                else Condition.STANDING_RECOVERED
            )
            found[recovered] = (
                f"no reason to hold for {timing.recovery:g} s, after: {self._reason}"
            )

    def _further_reasons(self, request: Request) -> list[str]:
        """Reasons to refuse a request that are not conditions, one line each."""
        if request is Request.READY:
            largest = self._robot.tendon.angle_max
            tolerance = self._settings.zero_tolerance
            return [  # of a wrong zero
                f"servo {leg} at {angle:.3g} rad, limits"
                f" [{-tolerance:.3g}, {largest + tolerance:.3g}]"
                if np.isfinite(angle)
                else f"servo {leg} has not told its angle yet"
                for leg, angle in zip(LEGS, self._tendon_angle)
                if not -tolerance <= angle <= largest + tolerance
            ]
        if request is Request.STAND and (unpowered := self._inputs.unpowered()):
            return unpowered
        limit, distance = (
            self._settings.arrived,
            self._inputs.distance(self._command),
        )
        if request is Request.WALK and not distance <= limit:  # nor NaN
            return [
                f"the legs are {distance:.3g} rad from their command, limit {limit:g} rad"
            ]
        if request is Request.WALK and not self._inputs.legs_are_known:
            return ["the stiffness of the legs is not measured yet"]
        return []

    def _transition(
        self, now: int, time: int, condition: Condition, reason: str
    ) -> None:
        """Make the transition of `condition`."""
        before, after = self._state, next_state(self._state, condition)
        self._state, self._reason, self._since = after, reason, now
        self._entered, self._clear_since = time, None
        self._resumed = before is State.HOLD and after is self._held_from
        if after is State.HOLD:
            self._resume = self._held_from = before
            begin = time - self._settings.timing.holds_window * SECOND
            self._holds = [*(t for t in self._holds if t > begin), time]
        elif after is State.READY:
            self._ready_since = time
            self._holds.clear()
            self._watch.reset()
            self._motion.reset()
            self._tendons = self._watch.state
        elif after is State.RELAX:
            self._faulty = condition in REASONS_TO_RELAX
