"""Watchdog of the servos: their action, from the supervisor's permission and the commands.

    no limits or no permission yet               HOLD
    permission HOLD, RELAX or OFF                the same; HOLD of a robot that walked moves the
                                                 legs to their common angle of standing
    permission PASS, no command yet              HOLD
    permission PASS and commands                 PASS: the goals follow them, rate-limited;
                                                 between two they continue at the command's rate
    permission or command older than
      command_hold                               HOLD
      command_lost                               RELAX: a ramp to slack, then torque off
    a fault of the servos                        RELAX

A RELAX begun by the watchdog itself lasts until the permission is OFF. The age of commands
counts under PASS only. Times are on a clock that never goes back, ns.
"""

import math
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.clock import SECOND, to_seconds
from slot_core.robot import LEGS
from slot_core.safety.rate_limiter import AT_REST, Goals, RateLimiter, unchanged
from slot_core.safety.settings import ServoLimits
from slot_core.safety.states import Action

NO_LIMITS = "no limits of the supervisor yet"
ZEROS, UNKNOWN = (
    partial(np.zeros, len(LEGS)),
    partial(np.full, len(LEGS), np.nan),
)


@dataclass(frozen=True)
class Permission:
    """Permission of the supervisor for the servos, received at `time` (ns)."""

    time: int
    action: Action
    fast: bool  # goals may move at rate_max: they have reached the commands
    reason: str
    stamp: int = 0  # ns, of the supervisor's message
    walks: bool = False  # whether PASS is that of a stride


@dataclass(frozen=True)
class ServoHealth:
    """State of the servos and their action on commands; arrays (4,) in the order of LEGS.

    Defaults: servos without faults.
    """

    action: Action
    reason: str  # why the action is not PASS, or ""
    torque: NDArray[np.bool_]  # as read back
    goal: Array  # rad, tendon angles sent to the servos last
    # whether the rate limit held it back
    slewed: NDArray[np.bool_] = field(
        default_factory=lambda: np.zeros(len(LEGS), dtype=np.bool_)
    )
    # s since the last answer; inf: never answered
    silence: Array = field(default_factory=ZEROS)
    # bits of HardwareError
    hardware_error: NDArray[np.int64] = field(
        default_factory=lambda: np.zeros(len(LEGS), dtype=np.int64)
    )
    temperature: Array = field(default_factory=UNKNOWN)  # degC; NaN: not known
    voltage: Array = field(default_factory=UNKNOWN)  # V; NaN: not known
    # share of the last exchanges that failed
    error_rate: Array = field(default_factory=ZEROS)
    # ns, stamp of the command written last, in lockstep arrived last; 0: none
    commanded: int = 0
    written: int = 0  # ns, time of that
    # ns, stamp of the first message of a supervisor that they took; 0: none
    supervised: int = 0


class Watchdog:
    """Rate limiter under the supervisor's permission and the time limits of messages.

    Until the limits of the supervisor are set it rejects commands and ignores permissions.
    """

    def __init__(self, angle_max: float):
        """Commands within [0, `angle_max`], rad; 0 is slack."""
        self.action, self.reason = Action.HOLD, NO_LIMITS
        self.permission: Permission | None = None
        self.overdue = False  # whether a command or permission is too old
        self.own_reason = ""  # of a RELAX begun by the watchdog itself
        self.supervised = 0  # ns, stamp of the first permission; 0: none
        self.limits: ServoLimits | None = None
        self._limiter: RateLimiter | None = None  # None: no limits yet
        self._angle_max = angle_max
        # rad, angles of the servos when torque came on
        self._engaged = np.zeros(len(LEGS))
        self._commanded: int | None = None  # time of the last accepted command
        # last time of a stride; None: not since then for `settling`
        self._strode: int | None = None

    @property
    def clock_jump(self) -> float:
        """Largest difference between a stamp and the present, s; inf without limits."""
        return math.inf if self.limits is None else self.limits.clock_jump

    def set_limits(self, limits: ServoLimits) -> None:
        """Use these limits from now on; the goals stay. Raises ConfigError as `RateLimiter`."""
        if limits == self.limits:
            return
        goal = self._engaged if self._limiter is None else self._limiter.goal
        self._limiter, self.limits = (
            RateLimiter(limits.gate, self._angle_max),
            limits,
        )
        self._limiter.engage(goal)

    def engage(self, angle: Array) -> None:
        """Start with goals at the servos' angles (4,), rad, and without a command."""
        self._engaged = np.array(angle, dtype=np.float64)
        if self._limiter is not None:
            self._limiter.engage(angle)
        self._commanded, self._strode, self.own_reason = None, None, ""

    @property
    def eases(self) -> bool:
        """Whether the goals of a stride are on their way to those of standing."""
        return self.action is Action.HOLD and self._strode is not None

    def offer(self, now: int, angle: Array, rate: Array = AT_REST) -> str:
        """Accept tendon angles (4,), rad, with their rate (4,), rad/s; or return why not."""
        fault = (
            NO_LIMITS
            if self._limiter is None
            else self._limiter.offer(now, angle, rate)
        )
        if not fault:
            self._commanded = now
        return fault

    def permit(self, permission: Permission) -> None:
        """Store the supervisor's newest permission."""
        self.supervised = self.supervised or permission.stamp
        if self._limiter is None:
            return
        if permission.fast and not (self.permission and self.permission.fast):
            self._limiter.since = permission.time
        if permission.action is Action.OFF:
            self.own_reason = ""
        self.permission = permission

    def relax(self, reason: str) -> None:
        """Ramp the tendons to slack in the next steps, then torque off."""
        self.own_reason = self.own_reason or reason

    def step(self, now: int) -> Goals:
        """Decide on the action and move the goals."""
        if self.limits is None or self._limiter is None:
            return unchanged(self.action, self._engaged, True)
        self.action, self.reason = self._decide(now, self.limits)
        permitted = None if self.permission is None else self.permission.time
        self.overdue = any(
            time is not None and now - time > self.limits.command_hold * SECOND
            for time in (self._commanded, permitted)
        )
        if self.action is Action.PASS:
            if self.permission is not None and self.permission.walks:
                self._strode = now
            elif now - (self._strode or now) > self.limits.settling * SECOND:
                self._strode = None  # a posture for `settling`
        return self._limiter.step(
            now,
            self.action,
            fast=self.permission is not None and self.permission.fast,
            ease=self.limits.standing_angle if self.eases else None,
        )

    def _decide(self, now: int, limits: ServoLimits) -> tuple[Action, str]:
        """Action and its reason, "" for PASS."""
        permission = self.permission
        received = None if permission is None else permission.time
        held = self._overdue("message of the supervisor", now, received, limits)
        if permission is not None and permission.action is Action.PASS:
            held = held or self._overdue(
                "command", now, self._commanded, limits
            )
        if permission is not None and permission.action is Action.OFF:
            return Action.OFF, permission.reason
        if self.own_reason:
            return Action.RELAX, self.own_reason
        if permission is not None and permission.action is Action.RELAX:
            return Action.RELAX, permission.reason
        if held or permission is None:
            return Action.HOLD, held
        return (
            permission.action,
            "" if permission.action is Action.PASS else permission.reason,
        )

    def _overdue(
        self, what: str, now: int, received: int | None, limits: ServoLimits
    ) -> str:
        """Reason to hold because of a late message, or ""; begins RELAX beyond `command_lost`."""
        if received is None:
            return f"no {what} yet"
        age = to_seconds(now - received)
        if age <= min(limits.command_hold, limits.command_lost):
            return ""
        line = f"no {what} for {age:.2f} s, limit"
        if age > limits.command_lost:
            self.relax(f"{line} {limits.command_lost:g} s")
        is_late = age > limits.command_hold
        return f"{line} {limits.command_hold:g} s" if is_late else ""
