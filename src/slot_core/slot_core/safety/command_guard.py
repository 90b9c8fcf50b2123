"""Guard of the commands: rejects them until the supervisor's limits have made the watchdog."""

from __future__ import annotations

import math

from slot_core.robot import Array
from slot_core.safety.command_gate import AT_REST
from slot_core.safety.command_watchdog import CommandWatchdog, Permission
from slot_core.safety.settings import ServoLimits

NO_LIMITS = "no limits of the supervisor yet"


class CommandGuard:
    """Command watchdog with the supervisor's limits; without limits it rejects every command."""

    def __init__(self, low: float, high: float) -> None:
        """Commands within [low, high], rad; `low` is slack."""
        self._range = low, high
        self.watchdog: CommandWatchdog | None = None  # None: no limits yet

    @property
    def limits(self) -> ServoLimits | None:
        """Limits that the supervisor has sent, or None."""
        return None if self.watchdog is None else self.watchdog.limits

    @property
    def clock_jump(self) -> float:
        """Largest difference between a stamp and the present, s; inf without limits."""
        return math.inf if self.limits is None else self.limits.clock_jump

    def set_limits(self, limits: ServoLimits) -> None:
        """Use these limits from now on; raises ConfigError as `CommandGate` does."""
        if self.watchdog is None:
            self.watchdog = CommandWatchdog(limits, *self._range)
        else:
            self.watchdog.set_limits(limits)

    def offer(self, now: int, angle: Array, rate: Array = AT_REST) -> str:
        """Accept tendon angles (4,), rad, with their rate (4,), rad/s; or return why not."""
        return NO_LIMITS if self.watchdog is None else self.watchdog.offer(now, angle, rate)

    def permit(self, permission: Permission) -> None:
        """Store the supervisor's newest permission; without limits it has no effect."""
        if self.watchdog is not None:
            self.watchdog.permit(permission)

    def relax(self, reason: str) -> None:
        """Ramp the tendons to slack in the next steps, then torque off."""
        if self.watchdog is not None:
            self.watchdog.relax(reason)

    @property
    def own_reason(self) -> str:
        """Reason of a RELAX begun by the watchdog itself, or ""."""
        return "" if self.watchdog is None else self.watchdog.own_reason

    @property
    def overdue(self) -> bool:
        """Whether a command or the supervisor's permission is too old."""
        return self.watchdog is not None and self.watchdog.overdue
