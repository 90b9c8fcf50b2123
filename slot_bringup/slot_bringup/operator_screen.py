"""Screen of the operator's terminal, from the newest message of every topic, and its keys."""

import math
import re
from collections import deque
from dataclasses import dataclass, field

import numpy as np
from diagnostic_msgs.msg import DiagnosticStatus
from sensor_msgs.msg import JointState

from slot_bringup import steering
from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_core.dynamics.servo import ServoSettings, read_servo
from slot_core.faults import hardware_errors
from slot_core.geometry import rotate, wrapped
from slot_core.messages import decode
from slot_core.robot import LEGS
from slot_core.safety.states import RELEASED, State
from slot_msgs.msg import GaitPreview, RobotState, ServoHealth
from slot_nodes.pace import Speed

SILENCE = 0.5  # s, age from which on a /robot_state is no longer shown
MEAN = 1.5  # s, over which velocities are means, some strides
KEYS = {
    "r": "ready",
    "s": "stand",
    "w": "walk",
    "x": "relax",
    " ": "estop",
    "R": "reset",
}
QUIT = "q"
KEY = re.compile(r"\x1b[\[O][0-9;]*[A-Za-z~]|.", re.S)  # characters of one key
HELP = (
    "r ready   s stand   w walk   x relax   SPACE E-STOP   R reset   q quit",
    steering.HELP,
)
HEADER = "     angle deg  torque N m  load %  slack mm  silent s  degC     V  lost %  power  errors"


class Motion:
    """Torso states of the last strides, and how fast the graph's clock goes."""

    def __init__(self) -> None:
        # stamp s, state (12,)
        self._states: deque[tuple[float, Array]] = deque()
        self._pace = Speed(MEAN)

    def add(self, now: float, stamp: float, state: Array) -> None:
        """Take a state (12,) with its stamp (s) at `now`, s of the terminal's clock."""
        if self._states and stamp <= self._states[-1][0]:
            self._states.clear()  # the clock was set
        self._states.append((stamp, state))
        while stamp - self._states[0][0] > MEAN:
            self._states.popleft()
        self._pace.add(now, stamp)

    def lines(self, now: float) -> list[str]:
        """Mean velocity in the heading frame, place, attitude, and share of real time."""
        if not self._states:
            return ["no state of the torso yet"]
        (begin, first), (end, last) = self._states[0], self._states[-1]
        velocity = np.full(3, math.nan)
        if end > begin:
            velocity[:2] = rotate(last[3:5] - first[3:5], -last[2]) / (
                end - begin
            )
            velocity[2] = wrapped(last[2] - first[2]) / (end - begin)
        roll, pitch, yaw = np.degrees(last[:3])
        x, y, z = last[3:6]
        return [
            f"reached  {_velocity(velocity)}   real-time factor"
            f" {_number(self._pace.until(now), 4, 2)}",
            f"x {x:+.3f}   y {y:+.3f} m   z {1e3 * z:.0f} mm"
            f"   roll {roll:+.1f}   pitch {pitch:+.1f}   yaw {yaw:+.1f} deg",
        ]


@dataclass
class OperatorView:
    """Newest messages; None before the first."""

    state: RobotState | None = None
    # s, arrival of `state` on the monotonic clock
    state_time: float = -math.inf
    joints: JointState | None = None
    health: ServoHealth | None = None
    preview: GaitPreview | None = None
    motion: Motion = field(default_factory=Motion)
    # by name
    diagnostics: dict[str, DiagnosticStatus] = field(default_factory=dict)
    answer: str = ""  # to the operator's last request
    servo: ServoSettings = field(default_factory=read_servo)

    def silent(self, now: float) -> bool:
        """Whether the last /robot_state is older than SILENCE at `now` (s)."""
        return now - self.state_time > SILENCE

    def alarming(self, now: float) -> bool:
        """Whether the first line is shown in red: no present state, or RELAX, ESTOP or FAULT."""
        return (
            self.state is None
            or self.silent(now)
            or State(self.state.state) in RELEASED
        )


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
    return [
        *_robot(view, now),
        "",
        _gait(view),
        *view.motion.lines(now),
        "",
        HEADER,
        *(_leg(view, k) for k in range(len(LEGS))),
        "",
        *_driver(view),
        f"> {view.answer}",
        *HELP,
    ]


def _gait(view: OperatorView) -> str:
    if view.preview is None:
        return "no gait yet"
    height, roll, pitch = view.preview.pose
    return (
        f"{view.preview.gait:8s} {_velocity(np.array(view.preview.velocity))}"
        f"   height {1e3 * height:.0f} mm   roll {math.degrees(roll):+.1f}"
        f"   pitch {math.degrees(pitch):+.1f} deg"
    )


def _velocity(velocity: Array) -> str:
    """Velocity (3,): v_x, v_y in m/s, yaw rate in rad/s."""
    x, y = (_number(v, 6, 3, "+") for v in velocity[:2])
    return f"{x} {y} m/s {_number(math.degrees(velocity[2]), 5, 1, '+')} deg/s"


def _number(value: float, width: int, digits: int, sign: str = "") -> str:
    """A number right-aligned, "-" where it is not known."""
    return (
        f"{value:{sign}{width}.{digits}f}"
        if math.isfinite(value)
        else f"{'-':>{width}}"
    )


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
    angle = torque = load = slack = math.nan
    if joints is not None:
        _, angles, torques = decode.joint_loads(joints)
        angle, torque = math.degrees(angles[k]), torques[k]
        voltage = math.nan if health is None else health.voltage[k]
        load = 100.0 * torque / float(view.servo.tendon_stall(voltage))
    if view.state is not None:
        slack = 1e3 * view.state.slack[k]
    columns = ((angle, 11, 1), (torque, 11, 2), (load, 7, 0), (slack, 9, 1))
    row = " ".join((LEGS[k], *(_number(*column) for column in columns)))
    if health is None:
        return row
    return (
        f"{row} {health.silence[k]:9.2f} {_number(health.temperature[k], 5, 0)}"
        f" {_number(health.voltage[k], 5, 1)}"
        f" {100.0 * health.error_rate[k]:7.1f} {'on' if health.torque[k] else 'off':>6}"
        f"  {hardware_errors(int(health.hardware_error[k]))}"
    )


def _driver(view: OperatorView) -> list[str]:
    """Action and reason of the servos, figures of their bus, and diagnostics that are not OK."""
    if view.health is None:
        return ["no report of the servos yet"]
    action = decode.ACTION_NUMBERS[view.health.action].name
    # is shown above
    status = [s for name, s in view.diagnostics.items() if name != "supervisor"]
    bus = [
        f"{v.key} {v.value}"
        for s in status
        for v in s.values
        if s.name == "servo bus"
    ]
    problems = [
        f"  ! {s.name}: {s.message}"
        for s in status
        if s.level != DiagnosticStatus.OK
    ]
    return [
        f"servos: {action} {view.health.reason}".rstrip(),
        *(["  " + ", ".join(bus)] if bus else []),
        *problems,
    ]
