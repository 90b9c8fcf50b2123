"""Commands, and the rate limiter: the last command, checked, and goals that follow it.

A command is tendon angles at the time of its acceptance, and their rate until the next one. It is
accepted or rejected as a whole. The goals follow it with a budget of time per leg:
unused time is kept up to `burst`, and a leg moves at most its budget times the largest rate. So
over any time T no goal moves further than rate_max (T + burst).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.clock import SECOND, to_seconds
from slot_core.compiled import kernel
from slot_core.robot import LEGS
from slot_core.safety.settings import GateSettings
from slot_core.safety.states import Action

AT_REST = np.zeros(len(LEGS))
"""Rate (4,), rad/s, of a command whose angles stay."""
AT_REST.flags.writeable = False
# s after a command in which the goals continue at its rate
EXTRAPOLATION_MAX = 0.1


def extrapolated(angle: Array, rate: Array, age: float | Array) -> Array:
    """Angles (..., 4), rad, that commands have reached at their rates (..., 4), rad/s, and ages, s.

    age: (...) or one for all; at most EXTRAPOLATION_MAX counts.
    """
    passed = np.minimum(np.maximum(age, 0.0), EXTRAPOLATION_MAX)
    return angle + passed[..., None] * rate


def command_fault(angle: Array, rate: Array, angle_max: float) -> str:
    """One line that names the first angle outside [0, angle_max] or value not finite, or ""."""
    for name, values in (("command", angle), ("rate", rate)):
        if np.shape(values) != (len(LEGS),):
            return (
                f"{name} has the shape {np.shape(values)}, limit ({len(LEGS)},)"
            )
    for leg, value in zip(LEGS, angle):
        if not 0.0 <= value <= angle_max:  # NaN is not
            return f"command {leg} = {value:.4g} rad is not inside [0, {angle_max:.4g}]"
    for leg, value in zip(LEGS, rate):
        if not np.isfinite(value):
            return f"rate {leg} = {value:.4g} rad/s is not finite"
    return ""


@dataclass(frozen=True)
class Goals:
    """Goals of the servos after a step of the rate limiter."""

    action: Action
    angle: Array  # (4,) rad, within the range
    torque: bool  # whether the servos may be under torque
    slewed: NDArray[np.bool_]  # (4,) whether the rate limit held the goal back


def unchanged(action: Action, angle: Array, torque: bool) -> Goals:
    """Goals that stay at angles (4,), rad."""
    return Goals(action, angle.copy(), torque, np.zeros(len(LEGS), dtype=bool))


@kernel
def _approach(goal, budget, target, rate, largest, slewed):  # type: ignore[no-untyped-def]  # noqa: PLR0917
    """Move goals (4,) towards a target (4,), rad, at a rate, rad/s, within budgets (4,), s.

    slewed (4,) is set where the budget holds a goal back.
    """
    for i in range(goal.size):
        distance, most = target[i] - goal[i], rate * budget[i]
        slewed[i] = abs(distance) > most
        step = -most if distance < -most else min(distance, most)
        spent = abs(step) / rate
        budget[i] = 0.0 if spent > budget[i] else budget[i] - spent
        moved = goal[i] + step if slewed[i] else target[i]
        # goal + distance may round to beyond the limit
        goal[i] = 0.0 if moved < 0.0 else min(moved, largest)


class RateLimiter:
    """Last accepted command, and goals that approach it at a limited rate.

    Times are on a clock that never goes back, ns.
    """

    def __init__(self, settings: GateSettings, angle_max: float):
        """Commands within [0, `angle_max`], rad; 0 is slack.

        Raises ConfigError when the ramp to slack takes longer than `relax_time`.
        """
        settings.check_ramp(angle_max)
        self.settings, self._angle_max = settings, angle_max
        self._target = np.zeros(len(LEGS))
        # rad/s; ns, time of the command
        self._target_rate, self._accepted = (AT_REST, 0)
        self._goal = self._target.copy()
        self._budget = np.zeros(len(LEGS))  # s
        self._action = Action.OFF
        self.since = 0  # ns, from when the rate of the present action grows
        self._time: int | None = None
        # whether the ramp to slack has ended in torque off
        self._relaxed = False
        self._move(self._target, settings.approach_rate)  # compiles its kernel

    @property
    def goal(self) -> Array:
        """(4,) rad, goals after the last step."""
        return self._goal.copy()

    def offer(self, time: int, angle: Array, rate: Array = AT_REST) -> str:
        """Accept angles (4,), rad, at `time` and their rate (4,), rad/s; or return why not."""
        fault = command_fault(angle, rate, self._angle_max)
        if not fault:
            self._target = np.array(angle, dtype=np.float64)
            self._target_rate, self._accepted = (
                np.array(rate, dtype=np.float64),
                time,
            )
        return fault

    def engage(self, angle: Array) -> None:
        """Set goals and command to the servos' angles (4,), rad: torque on without motion."""
        self._goal = np.clip(
            np.asarray(angle, dtype=np.float64), 0.0, self._angle_max
        )
        self._target, self._target_rate = self._goal.copy(), AT_REST

    def step(
        self,
        time: int,
        action: Action,
        fast: bool = False,
        ease: float | None = None,
    ) -> Goals:
        """Goals at `time`; `fast` allows `rate_max` instead of `approach_rate`.

        ease: rad, common angle to which the goals move under HOLD, at `approach_rate`; None: they
        stay.
        """
        elapsed = 0 if self._time is None else max(time - self._time, 0)
        self._time = time
        if action is not self._action:
            self._action, self.since, self._relaxed = action, time, False
        self._budget = np.minimum(
            self._budget + to_seconds(elapsed), self.settings.burst
        )
        if action is Action.PASS:
            age = to_seconds(time - self._accepted)
            angle = extrapolated(self._target, self._target_rate, age)
            return self._move(
                np.clip(angle, 0.0, self._angle_max), self._rate(time, fast)
            )
        if action is Action.RELAX:
            # torque goes off at the end of the ramp, whether or not the servos have followed
            moved = self._move(np.zeros(len(LEGS)), self.settings.relax_rate)
            self._relaxed = (
                self._relaxed
                or time - self.since >= self.settings.relax_time * SECOND
                or not self._goal.any()
            )
            return (
                unchanged(action, self._goal, False) if self._relaxed else moved
            )
        if action is Action.HOLD and ease is not None:
            return self._move(
                np.full(len(LEGS), ease), self.settings.approach_rate
            )
        return unchanged(action, self._goal, action is Action.HOLD)

    def _rate(self, time: int, fast: bool) -> float:
        """Largest rate of the goals, rad/s."""
        s = self.settings
        if not fast:
            return s.approach_rate
        share = to_seconds(time - self.since) / s.resume_time
        return s.approach_rate + (s.rate_max - s.approach_rate) * min(
            max(share, 0.0), 1.0
        )

    def _move(self, target: Array, rate: float) -> Goals:
        """Move the goals towards `target`, within the budget."""
        slewed = np.empty(len(LEGS), dtype=bool)
        _approach(
            self._goal, self._budget, target, rate, self._angle_max, slewed
        )
        return Goals(self._action, self.goal, True, slewed)
