"""The operator's terminal: requests to the running graph, and the live display with its keys."""

import argparse
import os
import select
import shutil
import socket
import sys
import termios
import textwrap
import time
import tty
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

from slot_bringup import operator_screen, steering
from slot_bringup.monitor import ListenerExecutor, listener
from slot_bringup.operator_screen import KEY, KEYS, QUIT
from slot_core.clock import to_seconds
from slot_core.command_line import show
from slot_core.messages import decode
from slot_core.messages.decode import ACTION_NUMBERS
from slot_core.refusal import InputError, printable
from slot_core.safety.states import Action, State
from slot_msgs.msg import (
    EmergencyStop,
    GaitPreview,
    MpcState,
    RobotState,
    ServoHealth,
)
from slot_msgs.srv import ForgetSource, InjectFault
from slot_nodes import qos, runtime

SEARCH_TIME = 5.0  # s to wait for a service or a message
ANSWER_TIME = 10.0  # s to wait for an answer; measuring a zero takes 0.5 s
ESTOP_PERIOD = 0.1  # s, a fifth of timing.estop of config/supervisor.yaml
LEAVE_TIME = 1.0  # s to wait until the supervisor has the last message
REFRESH = 0.2  # s between two redraws
NEWEST = QoSProfile(depth=1)


class OperateError(InputError):
    """A request failed; the message is one line."""


@dataclass(frozen=True)
class Service:
    """Service call to one node of the graph."""

    server: str  # the node's name in messages
    name: str
    kind: Any
    request: Any


def service(options: argparse.Namespace) -> Service:
    """Service call of an action of the command line."""
    if options.action in KEYS.values():
        return Service(
            "supervisor",
            f"supervisor/{options.action}",
            Trigger,
            Trigger.Request(),
        )
    if options.action == "forget":
        return Service(
            "supervisor",
            "supervisor/forget",
            ForgetSource,
            ForgetSource.Request(source=options.source),
        )
    if options.action == "inject":
        return Service(
            "simulated robot",
            "sim_robot/inject",
            InjectFault,
            InjectFault.Request(
                kind=options.kind,
                leg=options.leg,
                value=options.value,
                duration=options.duration,
                clear=options.clear,
            ),
        )
    return Service(
        "driver of servos",
        f"dynamixel_driver/{options.action}_{options.leg.lower()}",
        Trigger,
        Trigger.Request(),
    )


def call(wanted: Service, namespace: str) -> tuple[bool, str]:
    """Call a service of the graph in `namespace`; return success and message.

    Raises OperateError if there is no answer.
    """
    with listener("operate", namespace) as (node, executor):
        client = node.create_client(wanted.kind, wanted.name)
        if not client.wait_for_service(SEARCH_TIME):
            raise OperateError(no_answer(node, wanted.server, SEARCH_TIME))
        answer = client.call_async(wanted.request)
        if not executor.spin_until(answer.done, ANSWER_TIME):
            raise OperateError(no_answer(node, wanted.server, ANSWER_TIME))
        return answer.result().success, answer.result().message


def receive_state(namespace: str) -> RobotState:
    """Receive one /robot_state of the graph in `namespace`; raises OperateError if none arrives."""
    with listener("operate", namespace) as (node, executor):
        received: list[RobotState] = []
        node.create_subscription(
            RobotState, "robot_state", received.append, qos.STATE
        )
        if not executor.spin_until(lambda: bool(received), SEARCH_TIME):
            raise OperateError(no_answer(node, "supervisor", SEARCH_TIME))
        return received[0]


def no_answer(node: Node, server: str, limit: float) -> str:
    """Why a graph is not found: nothing answers within a limit, s."""
    place = f"ROS domain {node.context.get_domain_id()}, namespace {node.get_namespace()}"
    return f"no {server} answers in {place} within {limit:g} s: does scripts/run run?"


class Operator:
    """ROS interface of the live display: e-stop publisher, service clients, subscriptions."""

    def __init__(self, node: Node) -> None:
        self.view = operator_screen.OperatorView()
        self._estop = EmergencyStop(
            source=f"{socket.gethostname()}-{uuid.uuid4().hex[:4]}"
        )
        self._estop_topic = node.create_publisher(
            EmergencyStop, "estop", qos.SENSOR
        )
        self._clients = {
            name: node.create_client(Trigger, f"supervisor/{name}")
            for name in KEYS.values()
        }
        node.create_subscription(
            RobotState, "robot_state", self._on_state, qos.STATE
        )
        for kind, topic, name, check in (
            (JointState, "joint_states", "joints", decode.joint_loads),
            (ServoHealth, "servo_health", "health", decode.servo_health),
            (GaitPreview, "gait_preview", "preview", decode.preview),
        ):
            show: Any = partial(self._show, name, check)
            node.create_subscription(kind, topic, show, NEWEST)
        node.create_subscription(MpcState, "mpc_state", self._on_motion, NEWEST)
        node.create_subscription(
            DiagnosticArray, "diagnostics", self._on_diagnostics, 10
        )
        self._steering = steering.SteeringKeys(node)
        runtime.wall_timer(node, ESTOP_PERIOD, self._repeat)

    def press(self, key: str) -> bool:
        """Handle a key; return False to quit."""
        if key == QUIT:
            if not self._may_quit():
                return True
            # the supervisor need not miss this source of the e-stop
            self._estop.leaving = True
            self._publish_estop()
            self._estop_topic.wait_for_all_acked(Duration(seconds=LEAVE_TIME))
            return False
        request = KEYS.get(key)
        if request == "estop":
            self._estop.pressed = True
            self._publish_estop()
        if request is not None:
            self._call(request)
        elif said := self._steering.press(key, self.view.preview):
            self.view.answer = said
        return True

    def _may_quit(self) -> bool:
        """False under torque: without its e-stop source the robot would drop."""
        state = self.view.state
        if (
            state is None
            or self.view.silent(time.monotonic())
            or ACTION_NUMBERS[state.action] is Action.OFF
        ):
            return True
        self.view.answer = (
            f"{State(state.state).name}: relax first (x), or stop with Ctrl-C"
        )
        return False

    def _call(self, request: str) -> None:
        client = self._clients[request]
        if not client.service_is_ready():
            self.view.answer = f"{request}: no supervisor answers"
            return
        self.view.answer = f"{request} ..."

        def show(answer: Future) -> None:
            self.view.answer = answer_text(request, answer.result().message)

        client.call_async(Trigger.Request()).add_done_callback(show)

    def _show(
        self, name: str, check: Callable[[Any], object], message: Any
    ) -> bool:
        """Show a message, unless `check` raises ValueError: then a line says that it is invalid."""
        try:
            check(message)
        except ValueError as error:
            self.view.answer = f"{name} refused: {error}"
            return False
        setattr(self.view, name, message)
        return True

    def _on_state(self, message: RobotState) -> None:
        if not self._show("state", decode.robot_state, message):
            return
        self.view.state_time = time.monotonic()
        # once it is received, the supervisor has latched it
        self._estop.pressed &= message.state != RobotState.ESTOP

    def _on_motion(self, message: MpcState) -> None:
        try:
            estimate = decode.estimate(message)
        except ValueError as error:
            self.view.answer = f"motion refused: {error}"
            return
        self.view.motion.add(
            time.monotonic(), to_seconds(estimate.stamp), estimate.state
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        self.view.diagnostics |= {
            status.name: status for status in message.status
        }

    def _repeat(self) -> None:
        self._publish_estop()
        if (state := self.view.state) and not self.view.silent(
            time.monotonic()
        ):
            self._steering.repeat(state, self.view.preview)

    def _publish_estop(self) -> None:
        self._estop_topic.publish(self._estop)


def answer_text(action: str, message: str) -> str:
    """Text shown for the answer to an action."""
    return message or f"{action}: granted"


@contextmanager
def _terminal() -> Iterator[int]:
    """Set the terminal to unbuffered keys and the alternate screen; restored on exit."""
    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)
    try:
        tty.setcbreak(keyboard)
        print("\x1b[?1049h\x1b[?25l", end="", flush=True)
        yield keyboard
    finally:
        # the terminal may have been closed
        with suppress(OSError, termios.error):
            termios.tcsetattr(keyboard, termios.TCSANOW, before)
            print("\x1b[?25h\x1b[?1049l", end="", flush=True)


def live(namespace: str) -> None:
    """Show the robot's state and handle keys until the operator quits or the terminal is closed.

    It has the priority of the nodes, where there is a right to it: the e-stop waits for no other program.
    """
    runtime.take_priority("")
    with (
        listener("operate", namespace) as (node, executor),
        _terminal() as keyboard,
    ):
        operator = Operator(node)
        while _serve(executor, operator, keyboard):
            _draw(operator.view)


def _serve(
    executor: ListenerExecutor, operator: Operator, keyboard: int
) -> bool:
    """Handle messages and keys until the next redraw; return False to quit."""
    end = time.monotonic() + REFRESH
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
        if select.select([keyboard], [], [], 0.0)[0]:
            keys = os.read(keyboard, 64).decode(errors="replace")
            return bool(keys) and all(
                [operator.press(key) for key in KEY.findall(keys)]
            )
    return True


def _draw(view: operator_screen.OperatorView) -> None:
    now = time.monotonic()
    width, height = shutil.get_terminal_size()
    first, *others = map(printable, operator_screen.lines(view, now))
    colour = "\x1b[1;31m" if view.alarming(now) else "\x1b[1m"
    rows = [
        # wrapped: the end of a reason may be its cause
        *(f"{colour}{row}\x1b[0m" for row in textwrap.wrap(first, width)),
        *(line[:width] for line in others),
    ]
    screen = "\x1b[K\n".join(rows[:height])
    print(f"\x1b[H{screen}\x1b[K\x1b[J", end="", flush=True)


def act(options: argparse.Namespace, program: str) -> int:
    """Carry out the command line; returns the exit code. Raises OperateError."""
    if options.action is None:
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise OperateError(
                "the live display needs a terminal; `scripts/operate state` does not"
            )
        live(options.namespace)
    elif options.action == "state":
        return (
            0
            if show(
                program,
                operator_screen.state_lines(receive_state(options.namespace)),
            )
            else 2
        )
    else:
        success, message = call(service(options), options.namespace)
        if not success:
            raise OperateError(message)
        return 0 if show(program, [answer_text(options.action, message)]) else 2
    return 0
