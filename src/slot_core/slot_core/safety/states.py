"""States of the robot, transitions between them and requests of an operator, as data.

```mermaid
stateDiagram-v2
  [*] --> IDLE
  IDLE --> READY: READY_REQUESTED
  READY --> STANDING: STAND_REQUESTED
  WALKING --> STANDING: STAND_REQUESTED
  STANDING --> WALKING: WALK_REQUESTED
  STANDING --> HOLD: a reason to hold
  WALKING --> HOLD: a reason to hold
  HOLD --> STANDING: STANDING_RECOVERED
  HOLD --> WALKING: WALKING_RECOVERED
  READY --> RELAX: a fault, RELAX_REQUESTED
  STANDING --> RELAX: a fault, COMMAND_LOST, RELAX_REQUESTED
  WALKING --> RELAX: a fault, COMMAND_LOST, RELAX_REQUESTED
  HOLD --> RELAX: a fault, COMMAND_LOST, HELD_TOO_LONG, HELD_TOO_OFTEN, RELAX_REQUESTED
  RELAX --> IDLE: RELAXED
  RELAX --> FAULT: RELAXED_AFTER_FAULT
  IDLE --> FAULT: SERVO_FAULT
  FAULT --> IDLE: RESET_REQUESTED
  ESTOP --> IDLE: RESET_REQUESTED
  note right of ESTOP
    from every state by ESTOP_PRESSED, from those
    under torque by ESTOP_LOST
  end note
  note right of FAULT: faults are SERVO_FAULT, SERVO_SILENT, TILTED, SECOND_PUBLISHER
  note right of HOLD
    reasons to hold are CLOCK_JUMPED, NODE_LOST,
    TENDON_DAMAGED, NO_MOTION, SLIDING, MPC_STOPPED,
    ESTIMATE_LOST, COMMAND_REJECTED, COMMAND_STALE
  end note
```
"""

import enum


class Action(enum.Enum):
    """Reaction of the servos to commands."""

    PASS = "pass"  # follow them, rate-limited
    HOLD = "hold"  # keep the last goals; those of a stride ease to standing
    RELAX = "relax"  # a ramp to slack, then torque off
    OFF = "off"  # torque off at once


class State(enum.IntEnum):
    """State of the robot, which decides whether the servos may move."""

    IDLE = 0  # torque off
    READY = 1  # under torque, without motion
    STANDING = 2  # the servos follow the commands of a posture
    WALKING = 3  # the servos follow the commands of a stride
    HOLD = (
        4  # the last goals, after a stride standing, until the reason is gone
    )
    RELAX = 5  # a ramp to slack, then torque off
    ESTOP = 6  # torque off, until reset
    FAULT = 7  # torque off, until reset


# Tendons are slack, or become slack, because of a request or a fault.
RELEASED = (State.RELAX, State.ESTOP, State.FAULT)


class Condition(enum.Enum):
    """Causes of transitions, in the order of urgency."""

    ESTOP_PRESSED = "e-stop pressed"
    ESTOP_LOST = "e-stop source lost"
    SERVO_FAULT = "servo fault"
    SERVO_SILENT = "servo silent"
    TILTED = "tilted"
    SECOND_PUBLISHER = "second publisher"
    COMMAND_LOST = "commands lost"
    HELD_TOO_LONG = "held too long"
    HELD_TOO_OFTEN = "held too often"
    RELAX_REQUESTED = "relax requested"
    CLOCK_JUMPED = "clock jumped"
    NODE_LOST = "node lost"
    TENDON_DAMAGED = "tendon damaged"
    NO_MOTION = "no motion"
    SLIDING = "sliding"
    MPC_STOPPED = "MPC stopped"
    ESTIMATE_LOST = "estimate lost"
    COMMAND_REJECTED = "command rejected"
    COMMAND_STALE = "commands stale"
    RESET_REQUESTED = "reset requested"
    READY_REQUESTED = "ready requested"
    STAND_REQUESTED = "stand requested"
    WALK_REQUESTED = "walk requested"
    STANDING_RECOVERED = "stands again"
    WALKING_RECOVERED = "walks again"
    RELAXED = "relaxed"
    RELAXED_AFTER_FAULT = "relaxed after a fault"
    OFF_COMMAND = "off its command"


_I, _R, _S, _W, _H, _X, _E, _F = State

# Rows: conditions; columns: the state before, in the order of State.
#                                  IDLE READY STANDING WALKING HOLD RELAX ESTOP FAULT
TRANSITIONS: dict[Condition, tuple[State, ...]] = {
    Condition.ESTOP_PRESSED: (_E, _E, _E, _E, _E, _E, _E, _E),
    Condition.ESTOP_LOST: (_I, _E, _E, _E, _E, _E, _E, _F),
    Condition.SERVO_FAULT: (_F, _X, _X, _X, _X, _X, _E, _F),
    Condition.SERVO_SILENT: (_I, _X, _X, _X, _X, _X, _E, _F),
    Condition.TILTED: (_I, _X, _X, _X, _X, _X, _E, _F),
    Condition.SECOND_PUBLISHER: (_I, _X, _X, _X, _X, _X, _E, _F),
    Condition.COMMAND_LOST: (_I, _R, _X, _X, _X, _X, _E, _F),
    Condition.HELD_TOO_LONG: (_I, _R, _S, _W, _X, _X, _E, _F),
    Condition.HELD_TOO_OFTEN: (_I, _R, _S, _W, _X, _X, _E, _F),
    Condition.RELAX_REQUESTED: (_I, _X, _X, _X, _X, _X, _E, _F),
    Condition.CLOCK_JUMPED: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.NODE_LOST: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.TENDON_DAMAGED: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.NO_MOTION: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.SLIDING: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.MPC_STOPPED: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.ESTIMATE_LOST: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.COMMAND_REJECTED: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.COMMAND_STALE: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.RESET_REQUESTED: (_I, _R, _S, _W, _H, _X, _I, _I),
    Condition.READY_REQUESTED: (_R, _R, _S, _W, _H, _X, _E, _F),
    Condition.STAND_REQUESTED: (_I, _S, _S, _S, _H, _X, _E, _F),
    Condition.WALK_REQUESTED: (_I, _R, _W, _W, _H, _X, _E, _F),
    Condition.STANDING_RECOVERED: (_I, _R, _S, _W, _S, _X, _E, _F),
    Condition.WALKING_RECOVERED: (_I, _R, _S, _W, _W, _X, _E, _F),
    Condition.RELAXED: (_I, _R, _S, _W, _H, _I, _E, _F),
    Condition.RELAXED_AFTER_FAULT: (_I, _R, _S, _W, _H, _F, _E, _F),
    Condition.OFF_COMMAND: (_I, _R, _S, _W, _H, _X, _E, _F),
}

ACTIONS = {
    State.IDLE: Action.OFF,
    State.READY: Action.HOLD,
    State.STANDING: Action.PASS,
    State.WALKING: Action.PASS,
    State.HOLD: Action.HOLD,
    State.RELAX: Action.RELAX,
    State.ESTOP: Action.OFF,
    State.FAULT: Action.OFF,
}

REASONS_TO_HOLD = frozenset(
    c for c, row in TRANSITIONS.items() if row[_W] is _H
)
# They change no state.
REMARKS = frozenset(c for c, row in TRANSITIONS.items() if row == tuple(State))
# Faults of the robot itself: they count in every state under torque.
FAULTS = frozenset(
    c
    for c, row in TRANSITIONS.items()
    if row[_R] is _X and c is not Condition.RELAX_REQUESTED
)
REASONS_TO_RELAX = frozenset(
    c
    for c, row in TRANSITIONS.items()
    if row[_H] is _X and c is not Condition.RELAX_REQUESTED
)


def next_state(state: State, condition: Condition) -> State:
    """The state after `condition` in `state`."""
    return TRANSITIONS[condition][state]


OPERATOR = "the operator"


class Request(enum.Enum):
    """Requests of an operator."""

    READY = Condition.READY_REQUESTED
    STAND = Condition.STAND_REQUESTED
    WALK = Condition.WALK_REQUESTED
    RELAX = Condition.RELAX_REQUESTED
    RESET = Condition.RESET_REQUESTED
    ESTOP = Condition.ESTOP_PRESSED


# left by RESET alone, which no way below makes
LATCHED = (State.ESTOP, State.FAULT)
# Requests that lead from a state on: under torque, to a stride, to a posture.
TO_RISE = {State.IDLE: Request.READY}
TO_WALK = {State.READY: Request.STAND, State.STANDING: Request.WALK}
TO_STAND = dict.fromkeys(
    (State.READY, State.WALKING, State.HOLD), Request.STAND
)
# Advice where READY, STAND or WALK change nothing.
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
    if state in _FIRST and request in (
        Request.READY,
        Request.STAND,
        Request.WALK,
    ):
        return f"{request.name} refused in {state.name}: {_FIRST[state]}"
    return f"{request.name} changes nothing in {state.name}"
