"""Requests of an operator, and the conditions that forbid them."""

from __future__ import annotations

import enum

from slot_core.safety.states import REASONS_TO_HOLD, Condition, State

OPERATOR = "the operator"


class Request(enum.Enum):
    """Requests of an operator."""

    READY = Condition.READY_REQUESTED
    STAND = Condition.STAND_REQUESTED
    WALK = Condition.WALK_REQUESTED
    RELAX = Condition.RELAX_REQUESTED
    RESET = Condition.RESET_REQUESTED
    ESTOP = Condition.ESTOP_PRESSED


LATCHED = (State.ESTOP, State.FAULT)  # left by RESET alone, which no way below makes
# Requests that lead from a state on: under torque, to a stride, to a posture.
TO_RISE = {State.IDLE: Request.READY}
TO_WALK = {State.READY: Request.STAND, State.STANDING: Request.WALK}
TO_STAND = dict.fromkeys((State.READY, State.WALKING, State.HOLD), Request.STAND)
# What comes before READY, STAND or WALK where they change nothing.
_FIRST = {
    **dict.fromkeys(LATCHED, "reset first"),
    State.IDLE: "ready first",
    State.READY: "stand first",
    State.HOLD: "it ends when its reason is gone",
    State.RELAX: "wait for IDLE",
}
_TO_RESET = frozenset(
    {Condition.ESTOP_PRESSED, Condition.ESTOP_LOST, Condition.SERVO_FAULT}
)
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
_REACHED: dict[Request, tuple[State, ...]] = {
    Request.READY: (State.READY,),
    Request.STAND: (State.STANDING,),
    Request.WALK: (State.WALKING,),
    Request.RELAX: (State.RELAX, State.IDLE, State.ESTOP, State.FAULT),
    Request.RESET: (State.IDLE,),
    Request.ESTOP: (State.ESTOP,),
}


def no_change(request: Request, state: State) -> str:
    """Reason why a request has no effect in a state; "" if the state is the requested one."""
    if state in _REACHED[request]:
        return ""
    if state in _FIRST and request in (Request.READY, Request.STAND, Request.WALK):
        return f"{request.name} refused in {state.name}: {_FIRST[state]}"
    return f"{request.name} changes nothing in {state.name}"
