"""The last door before the servos: what passes is finite, within the range and not too fast.

A vector of tendon angles is taken whole or refused whole. What goes out follows what was taken,
with a budget of time per leg: unused time is kept up to `burst`, and a leg moves at most its budget
times the rate. So over any time T no goal moves further than rate_max (T + burst).
"""

from __future__ import annotations

import enum
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core.clock import SECOND
from slot_core.config import ConfigError
from slot_core.robot import LEGS, Array
from slot_core.safety.settings import GateSettings


class Action(enum.Enum):
    """What becomes of the commands."""

    PASS = "pass"  # the commands, slewed
    HOLD = "hold"  # the last angles again
    RELAX = "relax"  # a ramp to slack, then torque off
    OFF = "off"  # torque off at once


@dataclass(frozen=True)
class Gated:
    """What the servos are told."""

    action: Action
    angle: Array  # (4,) rad, within [0, angle_max]
    torque: bool  # whether the servos may be under torque
    slewed: NDArray[np.bool_]  # (4,) the command was further away than the rate allows


def command_fault(angle: Array, angle_max: float) -> str:
    """One line that names the first angle that cannot be used and its limit, or ""."""
    if np.shape(angle) != (len(LEGS),):
        return f"command has the shape {np.shape(angle)}, limit ({len(LEGS)},)"
    for leg, value in zip(LEGS, angle):
        if not 0.0 <= value <= angle_max:  # NaN is not
            return f"command {leg} = {value:.4g} rad is not inside [0, {angle_max:.4g}]"
    return ""


class CommandGate:
    """Keeps the last good command and moves the goals of the servos towards it.

    Time is that of a clock that never goes back, ns.
    """

    def __init__(self, settings: GateSettings, angle_max: float):
        """Raises ConfigError when the ramp to slack could not end before torque goes off."""
        ramp = angle_max / settings.relax_rate
        if settings.relax_time < ramp:
            raise ConfigError(
                f"supervisor.yaml: gate.relax_time = {settings.relax_time}: the ramp of"
                f" {angle_max:.3f} rad at relax_rate takes {ramp:.3f} s"
            )
        self._settings, self._limit = settings, angle_max
        self._target = np.zeros(len(LEGS))
        self._goal = np.zeros(len(LEGS))
        self._budget = np.zeros(len(LEGS))  # s
        self._action = Action.OFF
        self._since = 0  # ns, of the present action
        self._time: int | None = None
        self._relaxed = False

    @property
    def goal(self) -> Array:
        """(4,) rad, what was let out last."""
        return self._goal.copy()

    @property
    def relaxed(self) -> bool:
        """Whether a ramp to slack has ended in torque off."""
        return self._relaxed

    @property
    def distance(self) -> float:
        """Largest way from goal to command, rad."""
        return float(np.abs(self._target - self._goal).max())

    def offer(self, angle: Array) -> str:
        """Take a command (4,), rad, as a whole; or refuse it and say why."""
        fault = command_fault(angle, self._limit)
        if not fault:
            self._target = np.array(angle, dtype=np.float64)
        return fault

    def engage(self, angle: Array) -> None:
        """Let the goals be where the servos are, (4,), rad: torque comes on without motion."""
        self._goal = np.clip(np.asarray(angle, dtype=np.float64), 0.0, self._limit)
        self._target = self._goal.copy()

    def step(self, time: int, action: Action, fast: bool = False) -> Gated:
        """The goals at `time`; `fast` allows `rate_max` in place of `approach_rate`."""
        elapsed = self._pass_time(time)
        if action is not self._action:
            self._action, self._since, self._relaxed = action, time, False
        self._budget = np.minimum(self._budget + elapsed, self._settings.burst)
        if action is Action.PASS:
            return self._move(self._target, self._rate(time, fast), True)
        if action is Action.RELAX:
            return self._relax(time)
        return self._tell(action is Action.HOLD)

    def hurry(self, time: int) -> None:
        """Let the rate grow from `approach_rate` to `rate_max` from `time` on."""
        self._since = time

    def _pass_time(self, time: int) -> float:
        """Seconds since the last step."""
        elapsed = 0 if self._time is None else max(time - self._time, 0)
        self._time = time
        return elapsed / SECOND

    def _rate(self, time: int, fast: bool) -> float:
        s = self._settings
        if not fast:
            return s.approach_rate
        share = (time - self._since) / SECOND / s.resume_time
        return s.approach_rate + (s.rate_max - s.approach_rate) * min(max(share, 0.0), 1.0)

    def _relax(self, time: int) -> Gated:
        """The ramp; torque goes off at its end, which does not wait for the servos."""
        late = time - self._since >= self._settings.relax_time * SECOND
        gated = self._move(np.zeros(len(LEGS)), self._settings.relax_rate, not self._relaxed)
        self._relaxed = self._relaxed or late or not self._goal.any()
        return gated if not self._relaxed else self._tell(False)

    def _move(self, target: Array, rate: float, torque: bool) -> Gated:
        """Move the goals towards `target`, as far as the budget goes."""
        way = target - self._goal
        step = np.clip(way, -rate * self._budget, rate * self._budget)
        slewed = np.abs(way) > rate * self._budget
        self._budget = np.maximum(self._budget - np.abs(step) / rate, 0.0)
        # clipped, because goal + way may round to beyond the limit
        goal = np.where(slewed, self._goal + step, target)
        self._goal = np.clip(goal, 0.0, self._limit)
        return Gated(self._action, self.goal, torque, slewed)

    def _tell(self, torque: bool) -> Gated:
        return Gated(self._action, self.goal, torque, np.zeros(len(LEGS), dtype=bool))
