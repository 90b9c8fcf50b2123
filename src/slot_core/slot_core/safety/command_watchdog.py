"""What the servos do between the supervisor's word and the silence of those above them.

    no word yet                              HOLD
    the word HOLD, RELAX or OFF              that
    the word PASS, no command yet            HOLD
    the word PASS and commands               PASS: the goals follow them, slewed
    word or commands silent > command_hold   HOLD
    word or commands silent > command_lost   RELAX: a ramp to slack, then torque off
    a fault of the servos                    RELAX

RELAX for a reason of its own stays until the word has been OFF. Only under PASS are commands
missed. Times are those of a clock that never goes back, ns.
"""

from __future__ import annotations

from dataclasses import dataclass

from slot_core.clock import SECOND
from slot_core.robot import Array
from slot_core.safety.command_gate import Action, CommandGate, Gated
from slot_core.safety.settings import SupervisorSettings


@dataclass(frozen=True)
class Word:
    """What the supervisor allows at `time` (ns)."""

    time: int
    action: Action
    fast: bool  # walking: goals may move at rate_max
    reason: str


class CommandWatchdog:
    """The gate with those who may open it."""

    def __init__(self, settings: SupervisorSettings, angle_max: float):
        """Raises ConfigError as `CommandGate` does."""
        self.action, self.reason = Action.OFF, "not started"
        self._timing, self._gate = settings.timing, CommandGate(settings.gate, angle_max)
        self._word: Word | None = None
        self._heard: int | None = None  # time of the last good command
        self._letting_go = ""  # why it relaxes by itself

    def engage(self, angle: Array) -> None:
        """Begin with the goals where the servos are (4,), rad, and no command."""
        self._gate.engage(angle)
        self._heard, self._letting_go = None, ""

    def offer(self, now: int, angle: Array) -> str:
        """Take tendon angles (4,), rad, as a whole; or refuse them and say why."""
        fault = self._gate.offer(angle)
        if not fault:
            self._heard = now
        return fault

    def permit(self, word: Word) -> None:
        """Hear the supervisor."""
        if word.fast and not (self._word and self._word.fast):
            self._gate.hurry(word.time)
        if word.action is Action.OFF:
            self._letting_go = ""
        self._word = word

    def relax(self, reason: str) -> None:
        """Slacken the tendons in the steps to come, then torque off."""
        self._letting_go = self._letting_go or reason

    def step(self, now: int) -> Gated:
        """Decide, and say what the servos are told."""
        self.action, self.reason = self._decide(now)
        return self._gate.step(now, self.action, fast=self._word is not None and self._word.fast)

    @property
    def letting_go(self) -> str:
        """Why the legs go slack by its own rule, or ""."""
        return self._letting_go

    def _decide(self, now: int) -> tuple[Action, str]:
        word = self._word
        held = self._miss("word of the supervisor", now, None if word is None else word.time)
        if word is not None and word.action is Action.PASS:
            held = held or self._miss("command", now, self._heard)
        if word is not None and word.action is Action.OFF:
            return Action.OFF, word.reason
        if self._letting_go:
            return Action.RELAX, self._letting_go
        if word is not None and word.action is Action.RELAX:
            return Action.RELAX, word.reason
        if held or word is None:
            return Action.HOLD, held
        return word.action, "" if word.action is Action.PASS else word.reason

    def _miss(self, what: str, now: int, heard: int | None) -> str:
        """Why something that is late keeps the goals where they are, or ""; relaxes if too late."""
        if heard is None:
            return f"no {what} yet"
        age = (now - heard) / SECOND
        if age > self._timing.command_lost:
            self.relax(f"no {what} for {age:.2f} s, limit {self._timing.command_lost:g} s")
        if age > self._timing.command_hold:
            return f"no {what} for {age:.2f} s, limit {self._timing.command_hold:g} s"
        return ""
