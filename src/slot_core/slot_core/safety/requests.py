"""Requests of an operator, and the conditions that forbid them."""

from __future__ import annotations

import enum

from slot_core.safety.states import REASONS_TO_HOLD, Condition

OPERATOR = "the operator"


class Request(enum.Enum):
    """Requests of an operator."""

    READY = Condition.READY_REQUESTED
    STAND = Condition.STAND_REQUESTED
    WALK = Condition.WALK_REQUESTED
    RELAX = Condition.RELAX_REQUESTED
    RESET = Condition.RESET_REQUESTED
    ESTOP = Condition.ESTOP_PRESSED


_TO_RESET = frozenset({Condition.ESTOP_PRESSED, Condition.ESTOP_LOST, Condition.SERVO_FAULT})
_TO_READY = _TO_RESET | {Condition.SERVO_SILENT, Condition.TILTED}
_TO_MOVE = _TO_READY | REASONS_TO_HOLD | {Condition.COMMAND_LOST}
FORBIDDEN_BY: dict[Request, frozenset[Condition]] = {
    Request.READY: _TO_READY,
    Request.STAND: _TO_MOVE,
    Request.WALK: _TO_MOVE,
    Request.RELAX: frozenset(),
    Request.RESET: _TO_RESET,
    Request.ESTOP: frozenset(),
}
