"""The age of a command at the servos: the graph with emulated servos in real time, no bag.

The age is the time from the publication of an odometry reading until the goals computed from it are
written to the port. It excludes the sensor's delay of the odometry, and the transmission on the
wire, which is 0.34 ms for four goals at 1 Mbaud.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from nav_msgs.msg import Odometry

from benchmarks.harness import BenchmarkError
from slot_bringup.graph import read_graph
from slot_bringup.monitor import START_TIMEOUT, listener
from slot_bringup.run import started
from slot_core.bags import decode
from slot_core.bags.record_settings import read_record_settings
from slot_core.report.palette import INK, SECONDARY, STAGE_COLOURS
from slot_msgs.msg import ServoHealth
from slot_nodes import qos

# ms, by the share of commands that are older: goals for the robot; no check on another processor
GOALS = {0.5: 3.5, 0.01: 6.0}

Ages = npt.NDArray[np.float64]


def walk(duration: float, composed: bool) -> Ages:
    """Ages (s) of every command of a walk, the warm-up left out; raises BenchmarkError.

    composed: controller and driver in one process, else every node in its own.
    """
    graph, warm_up = read_graph(), read_record_settings().warm_up
    values = {argument.name: argument.default for argument in graph.arguments}
    values |= {"hardware": "fake_bus", "composed": composed}
    published: dict[int, int] = {}  # ns, by the odometry's stamp
    written: dict[int, int] = {}

    def on_odom(message: Odometry, info: Mapping[str, int]) -> None:
        published[decode.stamp(message)] = info["source_timestamp"]

    def on_health(message: ServoHealth) -> None:
        written.setdefault(decode.time(message.commanded), decode.time(message.written))

    with (
        tempfile.TemporaryDirectory() as logs,
        started(graph, values, Path(logs)) as processes,
        listener("age") as (node, executor),
    ):
        # rclpy also passes the second argument; its type annotation has only the first
        node.create_subscription(Odometry, "odom", cast(Any, on_odom), qos.SENSOR)
        node.create_subscription(ServoHealth, "servo_health", on_health, qos.SENSOR)
        limit = time.monotonic() + START_TIMEOUT
        while span(written) < warm_up + duration:
            executor.spin_once(timeout_sec=0.1)
            if (failure := processes.failed()) or time.monotonic() > limit + duration:
                raise BenchmarkError(f"the graph failed: {failure or 'no commands'}")
    begin = min(filter(None, written)) + warm_up * 1e9
    aged = [1e-9 * (at - published[s]) for s, at in written.items() if s in published and s > begin]
    return np.array(aged)


def span(written: Mapping[int, int]) -> float:
    """Time from the first command to the last, s; a zero stamp means: no command."""
    stamps = list(filter(None, written))
    return 1e-9 * (max(stamps) - min(stamps)) if stamps else 0.0


def row(found: Ages, nodes: str) -> dict[str, Any]:
    """Percentiles of the ages with separate or composed nodes."""
    p50, p90, p99 = 1e3 * np.percentile(found, [50, 90, 99])
    return {
        "kind": "age",
        "nodes": nodes,
        "commands": len(found),
        "p50_ms": p50,
        "p90_ms": p90,
        "p99_ms": p99,
        "largest_ms": 1e3 * found.max(),
    }


def draw(ages: Mapping[str, Ages], path: Path) -> None:
    """Write the picture: share of the commands older than an age, separate and composed nodes."""
    figure = Figure(figsize=(6.0, 3.4), layout="constrained")
    axes = figure.subplots()
    for (nodes, found), colour in zip(ages.items(), (INK, STAGE_COLOURS[0])):
        older = 1.0 - np.arange(len(found)) / len(found)
        axes.step(1e3 * np.sort(found), older, color=colour, label=f"{nodes} nodes")
    axes.plot(GOALS.values(), GOALS.keys(), "x", color=SECONDARY, label="goals, composed")
    axes.set(
        xlabel="from odometry published to goals written, ms",
        ylabel="share of commands that are older",
        yscale="log",
        xlim=(0.0, None),
    )
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)
