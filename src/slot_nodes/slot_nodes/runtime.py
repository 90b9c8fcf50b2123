"""Common functions of the nodes: start and clean end, parameters, publishers, timers."""

from __future__ import annotations

import ctypes
import gc
import math
import os
import signal
import sys
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, TypeVar, cast

import rclpy
import rclpy.utilities
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
)
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.signals import uninstall_signal_handlers
from rclpy.timer import Timer

from slot_core import config
from slot_core.refusal import one_line
from slot_nodes import messages
from slot_nodes.process import departure, intra_process
from slot_nodes.process.executor import DirectExecutor

T = TypeVar("T")
INTERRUPT_PERIOD = 0.5  # s between two exceptions that end a preparation
PRIORITY = 50  # that of an operating system's interrupts, and of ros2_control
LOCK_ALL = 1 | 2 | 4  # MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT of mlockall(2)


def spin(node: Any) -> None:
    """Serve a node until the context ends."""
    rclpy.spin(node, DirectExecutor())


class Interrupt:
    """Handler of SIGINT and SIGTERM: ends the preparation at once, a callback not before its end.

    SIGHUP, as of a lost connection to `ros2 launch`, acts as SIGTERM, unless it is ignored (nohup).

    While the node is served, only rclpy's own handler acts, which ends the context. An exception
    would be raised anywhere in a callback. Raised while rclpy converts a message it becomes a
    RuntimeError, or a null pointer in the converter's C code, which ends the process.

    During the preparation it is raised repeatedly: llvmlite, which compiles kernels, drops what is
    raised in its callbacks. An extension that is being imported makes an ImportError of it.

    rclpy ends the context and wakes the executors in a thread. At the end of the block, while the
    executors exist, it is joined: what it uses must neither be ended nor freed meanwhile.
    """

    def __init__(self) -> None:
        self.received = False
        self.prepares = True
        self._raises = True  # KeyboardInterrupt

    def __enter__(self) -> Interrupt:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._handle)
        signal.signal(signal.SIGALRM, self._raise)
        if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
            signal.signal(
                signal.SIGHUP, lambda *_: os.kill(os.getpid(), signal.SIGTERM)
            )
        return self

    def __exit__(self, *error: object) -> None:
        self._raises = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        uninstall_signal_handlers()
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)

    def end_preparation(self) -> None:
        """Raise an earlier interrupt that was dropped, and none from now on."""
        self._raises = self.prepares = False
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        if self.received:
            raise KeyboardInterrupt

    def _handle(self, number: int, frame: Any) -> None:
        self.received = True
        if self._raises:
            self._raises = False  # a Ctrl-C to the process group comes twice
            signal.setitimer(
                signal.ITIMER_REAL, INTERRUPT_PERIOD, INTERRUPT_PERIOD
            )
            raise KeyboardInterrupt

    def _raise(self, number: int, frame: Any) -> None:
        raise KeyboardInterrupt


def run(
    make_node: Callable[[], Any], serve: Callable[[Any], None] = spin
) -> None:
    """Serve a node or several until SIGINT, SIGTERM or `SystemExit`; exit code 0 unless it failed.

    At the end `close()` of the node is called, if it has one, then it is destroyed.
    An unusable configuration ends the process with one line and exit code 2.
    """
    node, nodes = None, list[Any]()
    interrupt = Interrupt()
    try:
        with interrupt:
            try:
                rclpy.init()  # its handlers of signals call those set before
            except (
                RuntimeError
            ) as error:  # arguments that are not YAML, a wrong domain
                raise config.ConfigError(error) from None
            node = make_node()
            nodes = getattr(node, "nodes", [node])
            for one in nodes:
                fix_clock(one)
            take_priority(os.environ.get("SLOT_PRIORITY", "0"))
            gc.freeze()  # exclude what is loaded by now from garbage collections
            interrupt.end_preparation()
            serve(node)
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except (config.ConfigError, ParameterException) as error:
        print(one_line(error), file=sys.stderr)
        sys.exit(2)
    except RuntimeError:
        if not interrupt.received and rclpy.utilities.ok():
            raise  # else of a message that was taken or published as the context ended
    except ImportError:
        if not (interrupt.received and interrupt.prepares):
            raise
    finally:
        close(nodes)
        failure = sys.exc_info()[1]  # on its way through this block
        code = 0 if failure is None else getattr(failure, "code", 1) or 0
        with departure.limited(code):
            if node is not None:
                node.destroy_node()
            rclpy.utilities.try_shutdown()


def close(nodes: Sequence[Any]) -> None:
    """Call `close()` of each node that has one, of the last made first."""
    for node in reversed(nodes):
        if hasattr(node, "close"):
            node.close()


def take_priority(wanted: str) -> None:
    """Take a real-time priority (SCHED_FIFO) with all threads, and lock the memory; "0": neither.

    "": PRIORITY, if there is a right to it. Only now, because nodes that prepare for seconds would
    keep each other from the processor. Raises ConfigError without the right to a given one.
    """
    priority = int(wanted or PRIORITY)
    if not priority:
        return
    for thread in os.listdir("/proc/self/task"):
        with suppress(ProcessLookupError):  # it has ended meanwhile
            try:
                os.sched_setscheduler(
                    int(thread), os.SCHED_FIFO, os.sched_param(priority)
                )
            except PermissionError:
                if not wanted:
                    get_logger("realtime").info(
                        "no right to a real-time priority: ordinary one"
                    )
                    return
                text = f"realtime = {priority}: no right to this priority; see rtprio"
                raise config.ConfigError(text) from None
    if ctypes.CDLL(None, use_errno=True).mlockall(LOCK_ALL):
        reason = os.strerror(ctypes.get_errno())
        get_logger("realtime").warning(
            f"memory is not locked: {reason}; see LimitMEMLOCK"
        )


def fix_clock(node: Node) -> None:
    """Refuse changes of `use_sim_time`: rclpy would change the clock of a node that runs."""
    text = "whether the time is that of /clock"
    kind = Parameter.Type.BOOL.value
    node.set_descriptor(
        "use_sim_time",
        ParameterDescriptor(type=kind, description=text, read_only=True),
    )


def declare_settings(
    node: Node, settings: T, prefix: str = "", read_only: bool = True
) -> T:
    """Declare each value of a settings object as a parameter; return it as overridden.

    Defaults are the values of `config/*.yaml`; bounds and descriptions are those of the fields.
    Raises ConfigError for a value outside its bounds.
    """
    changes = {}
    for name, value, meta in config.leaves(settings):
        default = list(value) if isinstance(value, tuple) else value
        given = declare(
            node,
            prefix + name,
            default,
            read_only=read_only,
            **_descriptor(meta, value),
        )
        changes[name] = plain_value(given)
    return config.replace(
        settings, changes, where=f"parameters of {node.get_name()}"
    )


def plain_value(value: Any) -> Any:
    """Value of a parameter as in a settings object; of an array a list."""
    return value if isinstance(value, (bool, int, float, str)) else list(value)


def declare(
    node: Node,
    name: str,
    default: Any,
    description: str,
    *,
    between: tuple[float, float] | None = None,
    read_only: bool = True,
    **descriptor: Any,
) -> Any:
    """Declare one parameter, a number `between` two ones, and return its value."""
    if between is not None:
        field, kind = _RANGES[type(default)]
        descriptor[field] = [kind(from_value=between[0], to_value=between[1])]
    return node.declare_parameter(
        name,
        default,
        ParameterDescriptor(
            description=description, read_only=read_only, **descriptor
        ),
    ).value


class PrefixedPublisher(Publisher):
    """Publisher that puts a prefix before the frames of its messages."""

    def __init__(self, prefix: str, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self._prefix = prefix

    def publish(self, msg: Any) -> None:
        """Publish a message, which is changed."""
        messages.prefix_frames(msg, self._prefix)
        super().publish(msg)


def frame_prefix(node: Node) -> str:
    """The parameter `frame_prefix`, declared once."""
    name = "frame_prefix"
    if not node.has_parameter(name):
        declare(
            node,
            name,
            "",
            "prefix of the frames in messages, for example fred/",
        )
    return str(node.get_parameter(name).value)


def publisher(
    node: Node, kind: type, topic: str, profile: QoSProfile
) -> Publisher:
    """Create a publisher of messages with frames; the parameter `frame_prefix` is put before them.

    With prefixes like fred/ the frames of several robots can share one tree of transforms.
    """
    prefix = frame_prefix(node)
    made = (
        cast(Any, partial(PrefixedPublisher, prefix)) if prefix else Publisher
    )
    return intra_process.publisher(
        node.create_publisher(kind, topic, profile, publisher_class=made)
    )


def wall_timer(
    node: Node, period: float, callback: Callable[[], None]
) -> Timer:
    """Create a timer on the steady clock: under `use_sim_time` the ROS clock may stand still."""
    return node.create_timer(
        period, callback, clock=Clock(clock_type=ClockType.STEADY_TIME)
    )


def last_logger(node: Node) -> RcutilsLogger:
    """Logger that works after the context has ended; its lines are not on /rosout."""
    return get_logger(f"{node.get_name()}.end")


def _descriptor(meta: Mapping[str, Any], value: Any) -> dict[str, Any]:
    """Parameter descriptor from description, unit and bounds of a field."""
    unit = f" [{meta['unit']}]" if meta.get("unit") else ""
    descriptor: dict[str, Any] = {"description": meta["doc"] + unit}
    if "options" in meta:
        descriptor["additional_constraints"] = "one of " + ", ".join(
            meta["options"]
        )
    if type(value) in _RANGES and all(
        math.isfinite(meta[end]) for end in ("low", "high")
    ):
        descriptor["between"] = tuple(
            type(value)(meta[end]) for end in ("low", "high")
        )
    return descriptor


_RANGES = {
    int: ("integer_range", IntegerRange),
    float: ("floating_point_range", FloatingPointRange),
}
