"""Monitor of a running graph: prints progress, detects missing messages and nodes that end."""

import math
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.signals import SignalHandlerOptions

from slot_bringup.graph import absolute
from slot_bringup.interrupts import deferred
from slot_bringup.processes import Processes, print_error
from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_core.messages import decode
from slot_core.refusal import printable
from slot_core.safety.states import RELEASED, Action, State
from slot_msgs.msg import MpcState, RobotState, TendonPlan
from slot_nodes import qos
from slot_nodes.pace import Speed
from slot_nodes.process import departure
from slot_nodes.process.executor import DirectExecutor

# s until the first /mpc_state; the first start compiles kernels
START_TIMEOUT = 90.0
SILENCE_TIMEOUT = 10.0  # s without a new /mpc_state
DISCOVERY_TIME = 1.0  # s to wait for messages of a graph that runs already
SPIN = 0.1  # s, longest wait for a message before an interrupt is raised
POLL = 0.02  # s between two looks at the messages: to wake up for each takes time from the graph
# of a topic that is looked at less often than it comes
NEWEST = QoSProfile(depth=1)
PACE_WINDOW = 1.0  # s
PACE_LIMIT = 0.9  # least share of real time; an odometry more or less in the window is 3 %
SKIPPED_LIMIT = 3.0  # states a second, of 30
PACE_REPORT = 5.0  # s between two lines on the pace
# s, in which DDS forgets a node that has ended, see departure.py
DEPARTURE_TIME = 0.1
REFRESH_TERMINAL, REFRESH_LOG = 0.2, 5.0  # s between progress lines


class RunError(RuntimeError):
    """A run failed; the message is one line."""


class SilenceError(RunError):
    """The controller has published no state for too long."""


class Progress:
    """Progress of a run: graph time, newest state of the torso and of the supervisor."""

    def __init__(self, supervised: bool) -> None:
        """The run begins at the first action PASS if supervised, else at the first torso state."""
        self.stamp = 0.0  # s, graph time of the last torso state
        self.elapsed = 0.0  # s, graph time since the begin; a clock that is set does not count
        self.state: Array | None = None  # (12,), as MpcState, SI
        self.robot: State | None = None
        self.reason = ""  # of the supervisor's last transition
        # of the walk: by their words, without numbers; those not printed yet
        self._warned: set[str] = set()
        self.news: list[str] = []
        self._begun = not supervised
        self._start = np.zeros(12)  # torso state at the begin
        self._updated = time.monotonic()
        self._time, self._skipped = Speed(PACE_WINDOW), Speed(PACE_WINDOW)

    def listen(self, node: Node, pace: bool) -> None:
        """Take the newest message of each topic when the node is spun; of the pace if wanted.

        A message that waited behind others would make a graph in real time look slow.
        """
        take = node.create_subscription
        take(MpcState, "mpc_state", self.update_torso, qos.STATE)
        take(RobotState, "robot_state", self.update_robot, qos.STATE)
        if pace:
            take(TendonPlan, "tendon_plan", self.update_plan, qos.STATE)
            take(Odometry, "ground_truth/odom", self.update_truth, NEWEST)

    def update_torso(self, message: MpcState) -> None:
        """Take the newest /mpc_state."""
        estimate = decode.estimate(message)
        stamp = to_seconds(estimate.stamp)
        if self.state is None or not self._begun:
            self._start = estimate.state
        elif 0.0 <= stamp - self.stamp <= SILENCE_TIMEOUT:
            self.elapsed += stamp - self.stamp
        self.stamp, self._updated = stamp, time.monotonic()
        self.state = estimate.state

    def update_truth(self, message: Odometry) -> None:
        """Take the newest /ground_truth/odom, which only a simulation publishes."""
        if self._begun:
            self._time.add(time.monotonic(), to_seconds(decode.stamp(message)))

    def update_plan(self, message: TendonPlan) -> None:
        """Take the newest /tendon_plan."""
        if self._begun:
            self._skipped.add(time.monotonic(), message.skipped)

    def update_robot(self, message: RobotState) -> None:
        """Take the newest /robot_state."""
        _, self.robot, action, self.reason = decode.robot_state(message)
        self._begun = self._begun or action is Action.PASS
        for line in message.warnings if self.robot is State.WALKING else ():
            words = re.sub(r"[-+.\d]+", "", line)
            if words not in self._warned:
                self.news.append(line)
            self._warned.add(words)

    @property
    def silence(self) -> float:
        """Wall time since the last /mpc_state, s."""
        return time.monotonic() - self._updated

    def slowness(self) -> str:
        """By how much simulation or controller are slower than real time, or ""."""
        now = time.monotonic()
        share, skipped = self._time.until(now), self._skipped.until(now)
        found = []
        if 0.0 <= share < PACE_LIMIT:
            found.append(f"the simulation went at {100 * share:.0f} % of it")
        if skipped > SKIPPED_LIMIT:
            found.append(
                f"mpc_controller skipped {skipped:.0f} states a second"
            )
        return f"slower than real time: {', '.join(found)}" if found else ""

    def line(self, whole: str = "") -> str:
        """Progress line: graph time of the `whole`, way since the begin, height, tilt and state."""
        if not self._begun and self.robot is not None:
            return printable(f"{self.robot.name}: {self.reason}")
        if self.state is None:
            return f"waiting for the first state ({self.silence:.0f} s)"
        if not np.isfinite(self.state).all():
            return f"t {self.elapsed:6.1f}{whole} s   the state is not finite"
        x, y = self.state[3:5] - self._start[3:5]
        tilt = math.degrees(
            math.acos(math.cos(self.state[0]) * math.cos(self.state[1]))
        )
        return (
            f"t {self.elapsed:6.1f}{whole} s   x {x:+.3f} m   y {y:+.3f} m   "
            f"z {1e3 * self.state[5]:3.0f} mm   tilt {tilt:4.1f} deg"
            + (f"   {self.robot.name}" if self.robot is not None else "")
        )


class PaceReport:
    """Prints a line while the graph is slower than real time, now and then."""

    def __init__(self, progress: Progress, remedy: str) -> None:
        """`remedy`: advice against it; "": nothing is printed."""
        self._progress, self._remedy = progress, remedy
        self._printed = -math.inf  # s, monotonic

    def print(self, urgent: bool) -> None:
        """Print the line if it holds, again after PACE_REPORT, or if the robot goes slack."""
        now = time.monotonic()
        if not self._remedy or (
            now - self._printed < PACE_REPORT and not urgent
        ):
            return
        if line := self._progress.slowness():
            self._printed = now
            print_error(f"{line}; {self._remedy}")


def watch(
    processes: Processes,
    duration: float,
    attended: bool = False,
    namespace: str = "",
    *,
    played: bool = False,
    remedy: str = "",
) -> None:
    """Return when the robot's clock has run for `duration` (s) since the begin of the run.

    A run in which a bag is `played` begins with its first state, whatever the supervisor decides,
    and may end with the bag. A process that ends and that the graph does not need is restarted or
    missed, with a line. With a `remedy` a graph slower than real time is reported, with it.

    Raises RunError when another process ends, no /mpc_state arrives for too long or, unless
    `attended` or `played`, the robot goes slack.
    """
    with listener("run", namespace) as (node, executor):
        progress = Progress("supervisor" in processes and not played)
        progress.listen(node, bool(remedy))
        pace = PaceReport(progress, remedy)
        try:
            terminal, shown = sys.stderr.isatty(), time.monotonic()
            refresh, end = (
                (REFRESH_TERMINAL, "\r") if terminal else (REFRESH_LOG, "\n")
            )
            while progress.elapsed < duration:
                time.sleep(POLL)
                executor.spin_once(0.0)
                pace.print(progress.robot in RELEASED)
                _check(progress, processes, attended or played)
                for line in (
                    *processes.restart_ended(progress.elapsed),
                    *progress.news,
                ):
                    print_error(line)
                progress.news.clear()
                if time.monotonic() - shown > refresh:
                    shown, line = (
                        time.monotonic(),
                        progress.line(f" of {duration:g}"),
                    )
                    print(line, end=end, file=sys.stderr, flush=True)
            print(progress.line(), file=sys.stderr)
        except SilenceError:
            if not played:
                raise  # else the bag has ended


def require_no_other_graph(namespace: str = "") -> None:
    """Raise RunError if a graph runs in this namespace of the ROS domain already.

    Two graphs would follow each other's commands. A running graph is recognised by the messages of
    estimator or supervisor, which has no estimate to wait for: DDS lists a killed node for another
    20 s.
    """
    with listener("run", namespace) as (node, executor):
        received: list[MpcState | RobotState] = []
        node.create_subscription(
            MpcState, "mpc_state", received.append, qos.CONTROL
        )
        node.create_subscription(
            RobotState, "robot_state", received.append, qos.STATE
        )
        if executor.spin_until(lambda: bool(received), DISCOVERY_TIME):
            raise RunError(
                f"another graph runs in ROS domain {node.context.get_domain_id()},"
                f" namespace {absolute(namespace)}:"
                " set another --namespace or ROS_DOMAIN_ID"
            )


class ListenerExecutor(DirectExecutor):
    """Executor of a program that watches a graph; an interrupt is raised after each spin."""

    def spin_once(self, timeout_sec: float | None = SPIN) -> None:
        """Handle events, waiting for one at most `timeout_sec`, then raise an interrupt."""
        with deferred():
            super().spin_once(timeout_sec=timeout_sec)

    def spin_until(self, condition: Callable[[], bool], limit: float) -> bool:
        """Handle events until a condition holds or `limit` (s) has passed; return the condition."""
        end = time.monotonic() + limit
        while not condition():
            if time.monotonic() > end:
                return False
            self.spin_once()
        return True


@contextmanager
def listener(
    name: str, namespace: str = ""
) -> Iterator[tuple[Node, ListenerExecutor]]:
    """Node `name` in a context of its own, with an executor; installs no signal handlers.

    An interrupt does not leave it half made: rclpy would print a traceback.
    """
    context, node = Context(), None
    try:
        with deferred():
            rclpy.init(
                args=[],
                context=context,
                signal_handler_options=SignalHandlerOptions.NO,
            )
            node = rclpy.create_node(name, context=context, namespace=namespace)
            executor = ListenerExecutor(context=context)
            executor.add_node(node)
        yield node, executor
    finally:
        with departure.limited(1):
            if node is not None:
                node.destroy_node()
            context.try_shutdown()


def _check(progress: Progress, processes: Processes, attended: bool) -> None:
    if failure := processes.failed():
        time.sleep(DEPARTURE_TIME)
        name, code = failure
        raise RunError(
            f"{name} ended with exit code {code}: {processes.last_line(name)}"
        )
    if progress.robot in RELEASED and not attended:
        raise RunError(
            f"the robot is in {progress.robot.name}: {progress.reason}"
        )
    if attended and progress.state is None:
        return  # nothing moves before the operator's first request
    limit = START_TIMEOUT if progress.state is None else SILENCE_TIMEOUT
    if progress.silence > limit:
        raise SilenceError(
            f"no /mpc_state for {progress.silence:.0f} s (limit {limit:g} s)"
        )
