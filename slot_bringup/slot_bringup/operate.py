"""The operator's terminal; without an action live, as the source of the e-stop, else one request.

ready     torque on where the legs are     stand     commands pass, slowly
walk      commands pass                    relax     a ramp to slack, then torque off
estop     torque off at once               reset     back from ESTOP and FAULT
state     what the robot does and why      reboot    restart a servo, torque off
zero      take a leg's position as its relaxed one, torque off
inject    a fault of the simulated robot
"""

from __future__ import annotations

import argparse
import os
import select
import shutil
import signal
import sys
import termios
import time
import tty
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from slot_bringup import operator_screen
from slot_bringup.monitor import listener
from slot_core.bags.decode import ACTIONS
from slot_core.robot import LEGS
from slot_core.safety.command_gate import Action
from slot_core.safety.states import State
from slot_msgs.msg import RobotState, ServoHealth
from slot_msgs.srv import InjectFault
from slot_nodes import qos, runtime

REQUESTS = ("ready", "stand", "walk", "relax", "estop", "reset")
KEYS = {"r": "ready", "s": "stand", "w": "walk", "x": "relax", " ": "estop", "R": "reset"}
QUIT = "q"
SEARCH_TIME = 5.0  # s until a node counts as not there
ANSWER_TIME = 10.0  # s; a servo's zero is measured for half a second
ESTOP_PERIOD = 0.1  # s, a fifth of timing.estop
REFRESH = 0.2  # s between two pictures
NEWEST = QoSProfile(depth=1)


class OperateError(RuntimeError):
    """A request that could not be made; the message is one line."""


@dataclass(frozen=True)
class Service:
    """A request to one node of the graph."""

    server: str  # what to call the node
    name: str
    kind: Any
    request: Any


def service(options: argparse.Namespace) -> Service:
    """What an action of the command line asks, and whom."""
    if options.action in REQUESTS:
        return Service("supervisor", f"/supervisor/{options.action}", Trigger, Trigger.Request())
    if options.action == "inject":
        names = ("kind", "leg", "value", "duration", "clear")
        fault = InjectFault.Request(**{name: getattr(options, name) for name in names})
        return Service("simulated robot", "/sim_robot/inject", InjectFault, fault)
    name = f"/dynamixel_driver/{options.action}_{options.leg.lower()}"
    return Service("driver of servos", name, Trigger, Trigger.Request())


def ask(wanted: Service) -> tuple[bool, str]:
    """Success and message of the answer; raises OperateError where there is none."""
    with listener("operate") as (node, executor):
        client = node.create_client(wanted.kind, wanted.name)
        if not client.wait_for_service(SEARCH_TIME):
            raise OperateError(_nobody(node, wanted.server, SEARCH_TIME))
        answer = client.call_async(wanted.request)
        executor.spin_until_future_complete(answer, ANSWER_TIME)
        if not answer.done():
            raise OperateError(_nobody(node, wanted.server, ANSWER_TIME))
        return answer.result().success, answer.result().message


def hear_state() -> RobotState:
    """The robot's present state; raises OperateError where nobody tells it."""
    with listener("operate") as (node, executor):
        heard: list[RobotState] = []
        node.create_subscription(RobotState, "robot_state", heard.append, qos.STATE)
        end = time.monotonic() + SEARCH_TIME
        while not heard:
            if time.monotonic() > end:
                raise OperateError(_nobody(node, "supervisor", SEARCH_TIME))
            executor.spin_once(timeout_sec=0.1)
        return heard[0]


def _nobody(node: Node, who: str, limit: float) -> str:
    domain = node.context.get_domain_id()
    return f"no {who} answers in ROS domain {domain} within {limit:g} s: does scripts/run run?"


class Operator:
    """The live terminal's part in the graph: the source of the e-stop, requests, and a view."""

    def __init__(self, node: Node) -> None:
        self.view = operator_screen.View()
        self._node = node
        self._pressed = False
        self._estop = node.create_publisher(Bool, "estop", qos.SENSOR)
        self._clients = {
            name: node.create_client(Trigger, f"/supervisor/{name}") for name in REQUESTS
        }
        node.create_subscription(RobotState, "robot_state", self._on_state, qos.STATE)
        for kind, topic, name in (
            (JointState, "joint_states", "joints"),
            (ServoHealth, "servo_health", "health"),
            (DiagnosticArray, "/diagnostics", "diagnostics"),
        ):
            node.create_subscription(kind, topic, partial(setattr, self.view, name), NEWEST)
        runtime.wall_timer(node, ESTOP_PERIOD, self._repeat)

    def press(self, key: str) -> bool:
        """Do what a key stands for; False to quit."""
        if key == QUIT:
            return not self._may_quit()
        request = KEYS.get(key)
        if request == "estop":
            self._pressed = True
            self._repeat()
        if request is not None:
            self._ask(request)
        return True

    def _may_quit(self) -> bool:
        """Under torque the robot would drop."""
        state = self.view.state
        if state is None or self.view.silent(time.monotonic()):
            return True
        if ACTIONS[state.action] is Action.OFF:
            return True
        self.view.answer = f"{State(state.state).name}: relax first (x), or stop it by Ctrl-C"
        return False

    def _ask(self, request: str) -> None:
        client = self._clients[request]
        if not client.service_is_ready():
            self.view.answer = f"{request}: no supervisor answers"
            return
        self.view.answer = f"{request} ..."
        client.call_async(Trigger.Request()).add_done_callback(partial(self._on_answer, request))

    def _on_answer(self, request: str, answer: Future) -> None:
        self.view.answer = verdict(request, answer.result().message)

    def _on_state(self, message: RobotState) -> None:
        self.view.state, self.view.heard = message, time.monotonic()
        if message.state == RobotState.ESTOP:
            self._pressed = False  # it has been heard, and is latched

    def _repeat(self) -> None:
        self._estop.publish(Bool(data=self._pressed))
        self.view.sources = self._node.count_publishers("estop")


def verdict(action: str, message: str) -> str:
    """What to tell of an answer."""
    return message or f"{action}: granted"


@contextmanager
def _terminal() -> Iterator[int]:
    """Keys as they are pressed, and a page of our own; given back however it ends."""
    keyboard = sys.stdin.fileno()
    before = termios.tcgetattr(keyboard)
    try:
        tty.setcbreak(keyboard)
        print("\x1b[?1049h\x1b[?25l", end="", flush=True)
        yield keyboard
    finally:
        with suppress(OSError, termios.error):  # a terminal that has been closed
            termios.tcsetattr(keyboard, termios.TCSANOW, before)
            print("\x1b[?25h\x1b[?1049l", end="", flush=True)


def live() -> None:
    """Show the robot and take keys until the operator quits or the terminal is closed."""
    with listener("operate") as (node, executor), _terminal() as keyboard:
        operator = Operator(node)
        while _serve(executor, operator, keyboard):
            _draw(operator.view)


def _serve(executor: SingleThreadedExecutor, operator: Operator, keyboard: int) -> bool:
    """Messages and keys until the next picture; False at the end."""
    end = time.monotonic() + REFRESH
    while time.monotonic() < end:
        executor.spin_once(timeout_sec=0.05)
        if select.select([keyboard], [], [], 0.0)[0]:
            keys = os.read(keyboard, 64).decode(errors="replace")
            return bool(keys) and all([operator.press(key) for key in keys])
    return True


def _draw(view: operator_screen.View) -> None:
    now = time.monotonic()
    width, height = shutil.get_terminal_size()
    first, *others = (line[:width] for line in operator_screen.lines(view, now)[:height])
    colour = "\x1b[1;31m" if view.alarming(now) else "\x1b[1m"
    picture = "\x1b[K\n".join((f"{colour}{first}\x1b[0m", *others))
    print(f"\x1b[H{picture}\x1b[K\x1b[J", end="", flush=True)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of `scripts/operate`; returns the exit code."""
    options = _parser().parse_args(arguments)
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    try:
        return _act(options)
    except OperateError as error:
        print(f"scripts/operate: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130


def _act(options: argparse.Namespace) -> int:
    if options.action is None:
        if not (sys.stdin.isatty() and sys.stdout.isatty()):
            raise OperateError("live it needs a terminal; scripts/operate state does without")
        live()
    elif options.action == "state":
        print("\n".join(operator_screen.state_lines(hear_state())))
    else:
        success, message = ask(service(options))
        if not success:
            raise OperateError(message)
        print(verdict(options.action, message))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/operate",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    for name in (*REQUESTS, "state"):
        actions.add_parser(name)
    for name in ("reboot", "zero"):
        actions.add_parser(name).add_argument("leg", choices=LEGS)
    inject = actions.add_parser("inject")
    inject.add_argument("kind", help="as in config/scene")
    inject.add_argument("leg", choices=(*LEGS, "all"), nargs="?", default="all")
    inject.add_argument("--value", type=float, default=0.0, help="what the kind says")
    inject.add_argument("--duration", type=float, default=0.0, help="s, else until cleared")
    inject.add_argument("--clear", action="store_true", help="take such a fault back")
    return parser


if __name__ == "__main__":
    sys.exit(main())
