"""Action of the servos, from the supervisor's permission, the commands and the age of both.

    no permission yet                            HOLD
    permission HOLD, RELAX or OFF                the same
    permission PASS, no command yet              HOLD
    permission PASS and commands                 PASS: the goals follow them, rate-limited; a
                                                 command goes on at its rate until the next one
    permission or command older than
      command_hold                               HOLD
      command_lost                               RELAX: a ramp to slack, then torque off
    a fault of the servos                        RELAX

A RELAX begun by the watchdog itself lasts until the permission is OFF. The age of commands
counts under PASS only. Times are those of a clock that never goes back, ns.
"""

from __future__ import annotations

from dataclasses import dataclass

from slot_core.clock import SECOND, to_seconds
from slot_core.robot import Array
from slot_core.safety.command_gate import AT_REST, Action, CommandGate, Gated
from slot_core.safety.settings import ServoLimits


@dataclass(frozen=True)
class Permission:
    """What the supervisor permits the servos to do, received at `time` (ns)."""

    time: int
    action: Action
    fast: bool  # goals may move at rate_max: they have reached the commands
    reason: str


class CommandWatchdog:
    """Command gate under the supervisor's permission and the time limits of messages."""

    def __init__(self, limits: ServoLimits, low: float, high: float):
        """Commands within [low, high], rad; raises ConfigError as `CommandGate` does."""
        self.action, self.reason = Action.OFF, "not started"
        self.limits = limits
        self._gate = CommandGate(limits.gate, low, high)
        self._range = low, high
        self.permission: Permission | None = None
        self._commanded: int | None = None  # time of the last accepted command
        self._own_reason = ""  # of a RELAX begun by the watchdog itself
        self.overdue = False  # whether a command or permission is too old

    def set_limits(self, limits: ServoLimits) -> None:
        """Use other limits from now on; the goals stay. Raises ConfigError as `CommandGate`."""
        if limits == self.limits:
            return
        goal, self._gate = self._gate.goal, CommandGate(limits.gate, *self._range)
        self._gate.engage(goal)
        self.limits = limits

    def engage(self, angle: Array) -> None:
        """Start with goals at the servos' angles (4,), rad, and without a command."""
        self._gate.engage(angle)
        self._commanded, self._own_reason = None, ""

    def offer(self, now: int, angle: Array, rate: Array = AT_REST) -> str:
        """Accept tendon angles (4,), rad, with their rate (4,), rad/s; or return why not."""
        fault = self._gate.offer(now, angle, rate)
        if not fault:
            self._commanded = now
        return fault

    def permit(self, permission: Permission) -> None:
        """Store the supervisor's newest permission."""
        if permission.fast and not (self.permission and self.permission.fast):
            self._gate.restart_rate(permission.time)
        if permission.action is Action.OFF:
            self._own_reason = ""
        self.permission = permission

    def relax(self, reason: str) -> None:
        """Ramp the tendons to slack in the next steps, then torque off."""
        self._own_reason = self._own_reason or reason

    def step(self, now: int) -> Gated:
        """Decide on the action and move the goals."""
        self.action, self.reason = self._decide(now)
        received = [] if self._commanded is None else [self._commanded]
        received += [] if self.permission is None else [self.permission.time]
        self.overdue = any(now - time > self.limits.command_hold * SECOND for time in received)
        fast = self.permission is not None and self.permission.fast
        return self._gate.step(now, self.action, fast=fast)

    @property
    def own_reason(self) -> str:
        """Reason of a RELAX begun by the watchdog itself, or ""."""
        return self._own_reason

    def _decide(self, now: int) -> tuple[Action, str]:
        """Action and its reason, "" for PASS."""
        permission = self.permission
        received = None if permission is None else permission.time
        held = self._overdue("message of the supervisor", now, received)
        if permission is not None and permission.action is Action.PASS:
            held = held or self._overdue("command", now, self._commanded)
        if permission is not None and permission.action is Action.OFF:
            return Action.OFF, permission.reason
        if self._own_reason:
            return Action.RELAX, self._own_reason
        if permission is not None and permission.action is Action.RELAX:
            return Action.RELAX, permission.reason
        if held or permission is None:
            return Action.HOLD, held
        return permission.action, "" if permission.action is Action.PASS else permission.reason

    def _overdue(self, what: str, now: int, received: int | None) -> str:
        """Reason to hold because of a late message, or ""; begins RELAX beyond `command_lost`."""
        if received is None:
            return f"no {what} yet"
        age, limits = to_seconds(now - received), self.limits
        if age > limits.command_lost:
            self.relax(f"no {what} for {age:.2f} s, limit {limits.command_lost:g} s")
        if age > limits.command_hold:
            return f"no {what} for {age:.2f} s, limit {limits.command_hold:g} s"
        return ""
