"""States of the robot and the transitions between them, as data.

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
  HOLD --> RELAX: a fault, COMMAND_LOST, HELD_TOO_LONG, RELAX_REQUESTED
  RELAX --> IDLE: RELAXED
  RELAX --> FAULT: RELAXED_AFTER_FAULT
  IDLE --> FAULT: SERVO_FAULT
  FAULT --> IDLE: RESET_REQUESTED
  ESTOP --> IDLE: RESET_REQUESTED
  note right of ESTOP
    from every state by ESTOP_PRESSED, from those
    under torque by ESTOP_LOST
  end note
  note right of FAULT: faults are SERVO_FAULT, SERVO_SILENT, TILTED
  note right of HOLD
    reasons to hold are CLOCK_JUMPED, NODE_LOST,
    TENDON_DAMAGED, NO_MOTION, MPC_STOPPED,
    ESTIMATE_LOST, COMMAND_REJECTED, COMMAND_STALE
  end note
```
"""

from __future__ import annotations

import enum

from slot_core.safety.commands import Action


class State(enum.IntEnum):
    """State of the robot, which decides whether the servos may move."""

    IDLE = 0  # torque off
    READY = 1  # under torque, without motion
    STANDING = 2  # the servos follow the commands of a posture
    WALKING = 3  # the servos follow the commands of a stride
    HOLD = 4  # the last goals, until the reason is gone
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
    COMMAND_LOST = "commands lost"
    HELD_TOO_LONG = "held too long"
    RELAX_REQUESTED = "relax requested"
    CLOCK_JUMPED = "clock jumped"
    NODE_LOST = "node lost"
    TENDON_DAMAGED = "tendon damaged"
    NO_MOTION = "no motion"
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


_I, _R, _S, _W, _H, _X, _E, _F = State

# Rows: conditions; columns: the state before, in the order of State.
#                                  IDLE READY STANDING WALKING HOLD RELAX ESTOP FAULT
TRANSITIONS: dict[Condition, tuple[State, ...]] = {
    Condition.ESTOP_PRESSED: (_E, _E, _E, _E, _E, _E, _E, _E),
    Condition.ESTOP_LOST: (_I, _E, _E, _E, _E, _E, _E, _F),
    Condition.SERVO_FAULT: (_F, _X, _X, _X, _X, _X, _E, _F),
    Condition.SERVO_SILENT: (_I, _X, _X, _X, _X, _X, _E, _F),
    Condition.TILTED: (_I, _X, _X, _X, _X, _X, _E, _F),
    Condition.COMMAND_LOST: (_I, _R, _X, _X, _X, _X, _E, _F),
    Condition.HELD_TOO_LONG: (_I, _R, _S, _W, _X, _X, _E, _F),
    Condition.RELAX_REQUESTED: (_I, _X, _X, _X, _X, _X, _E, _F),
    Condition.CLOCK_JUMPED: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.NODE_LOST: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.TENDON_DAMAGED: (_I, _R, _H, _H, _H, _X, _E, _F),
    Condition.NO_MOTION: (_I, _R, _H, _H, _H, _X, _E, _F),
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

REASONS_TO_HOLD = frozenset(c for c, row in TRANSITIONS.items() if row[_W] is _H)
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
