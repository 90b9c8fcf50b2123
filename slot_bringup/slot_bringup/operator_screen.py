"""Screen of the operator's terminal, made from the newest message of every topic."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState

from slot_core.clock import to_seconds
from slot_core.hardware_error import hardware_errors
from slot_core.messages import decode
from slot_core.robot import LEGS
from slot_core.safety.states import RELEASED, State
from slot_msgs.msg import RobotState, ServoHealth

SILENCE = 0.5  # s, age from which on a /robot_state is no longer shown
HELP = "r ready   s stand   w walk   x relax   SPACE E-STOP   R reset   q quit"
HEADER = "     angle deg  torque N m  slack mm  silent s  degC     V  lost %  power  errors"


@dataclass
class OperatorView:
    """Newest messages; None before the first."""

    state: RobotState | None = None
    state_time: float = -math.inf  # s, arrival of `state` on the monotonic clock
    joints: JointState | None = None
    health: ServoHealth | None = None
    diagnostics: dict[str, DiagnosticStatus] = field(default_factory=dict)  # by name
    answer: str = ""  # to the operator's last request

    def silent(self, now: float) -> bool:
        """Whether the last /robot_state is older than SILENCE at `now` (s)."""
        return now - self.state_time > SILENCE

    def alarming(self, now: float) -> bool:
        """Whether the first line is shown in red: no present state, or RELAX, ESTOP or FAULT."""
        return self.state is None or self.silent(now) or State(self.state.state) in RELEASED


def state_lines(message: RobotState) -> list[str]:
    """State, its age and reason in one line; then each warning in a line."""
    since = decode.time(message.since)
    held = to_seconds(decode.stamp(message) - since)
    span = f" for {held:.1f} s" if since else ""  # 0: not set yet
    return [
        f"{State(message.state).name}{span}: {message.reason}",
        *(f"  ! {warning}" for warning in message.warnings),
    ]


def lines(view: OperatorView, now: float) -> list[str]:
    """All lines of the screen at `now` (s)."""
    legs = [_leg(view, k) for k in range(len(LEGS))]
    end = [f"> {view.answer}", HELP]
    return [*_robot(view, now), "", HEADER, *legs, "", *_driver(view), *end]


def _robot(view: OperatorView, now: float) -> list[str]:
    if view.state is None:
        return ["no state from the supervisor yet"]
    if view.silent(now):
        return [
            f"NO STATE from the supervisor for {now - view.state_time:.1f} s, limit {SILENCE:g} s"
        ]
    return state_lines(view.state)


def _leg(view: OperatorView, k: int) -> str:
    joints, health = view.joints, view.health
    angle = torque = slack = math.nan
    if joints is not None:
        _, angles, torques = decode.joint_loads(joints)
        angle, torque = math.degrees(angles[k]), torques[k]
    if view.state is not None:
        slack = 1e3 * view.state.slack[k]
    row = f"{LEGS[k]} {angle:11.1f} {torque:11.2f} {slack:9.1f}"
    if health is None:
        return row
    return (
        f"{row} {health.silence[k]:9.2f} {health.temperature[k]:5.0f} {health.voltage[k]:5.1f}"
        f" {100.0 * health.error_rate[k]:7.1f} {'on' if health.torque[k] else 'off':>6}"
        f"  {hardware_errors(int(health.hardware_error[k]))}"
    )


def _driver(view: OperatorView) -> list[str]:
    """Action and reason of the servos, figures of their bus, and diagnostics that are not OK."""
    if view.health is None:
        return ["no report of the servos yet"]
    action = decode.ACTION_NUMBERS[view.health.action].name
    status = [s for name, s in view.diagnostics.items() if name != "supervisor"]  # is shown above
    bus = [f"{v.key} {v.value}" for s in status for v in s.values if s.name == "servo bus"]
    problems = [f"  ! {s.name}: {s.message}" for s in status if s.level != DiagnosticStatus.OK]
    first = f"servos: {action} {view.health.reason}".rstrip()
    return [first, *(["  " + ", ".join(bus)] if bus else []), *problems]
