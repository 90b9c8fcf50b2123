"""The age of a command at the servos: the graph with emulated servos in real time, no bag.

The age is the time from the publication of the sample of the IMU that led to a tick until the goals
of the tick are written to the port. It excludes the transmission on the wire, which is 0.34 ms for
four goals at 1 Mbaud.
"""

import math
import subprocess
import sys
import tempfile
import time
from bisect import bisect_left
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.figure import Figure
from sensor_msgs.msg import Imu

from benchmarks.harness import BenchmarkError, Check, Row, at_most
from benchmarks.plots import draw_longer
from slot_bringup.graph import read_graph
from slot_bringup.monitor import START_TIMEOUT, listener
from slot_bringup.run import started
from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.messages import decode
from slot_core.recording.record_settings import read_record_settings
from slot_msgs.msg import ServoHealth
from slot_nodes import qos

SEPARATE, COMPOSED = "separate", "composed"
BUSY = "composed, one core kept busy"
NODES = (SEPARATE, COMPOSED, BUSY)
# ms, composed, by the share of commands that are older
GOALS = {0.5: 3.5, 0.01: 6.0}
BUSY_GOAL = 10.0  # ms, of which 1 % may be older with one core kept busy
AGE_RATIO = 0.7  # of the median age of a command, composed over separate nodes


def walk(duration: float, nodes: str) -> Array:
    """Array (s) of every command of a walk, the warm-up left out; raises BenchmarkError.

    nodes: `SEPARATE`, or `COMPOSED` or `BUSY` for the controller in one process, the driver in another.
    """
    graph, warm_up = read_graph(), read_record_settings().warm_up
    values = {argument.name: argument.default for argument in graph.arguments}
    values |= {"hardware": "fake_bus", "composed": nodes != SEPARATE}
    published: dict[int, int] = {}  # ns, by the IMU's stamp
    written: dict[int, int] = {}

    def on_imu(message: Imu, info: Mapping[str, int]) -> None:
        published[decode.stamp(message)] = info["source_timestamp"]

    def on_health(message: ServoHealth) -> None:
        written.setdefault(
            decode.time(message.commanded), decode.time(message.written)
        )

    with (
        tempfile.TemporaryDirectory() as logs,
        busy_core() if nodes == BUSY else nullcontext(),
        started(graph, values, Path(logs)) as processes,
        listener("age") as (node, executor),
    ):
        # rclpy also passes the second argument; its type annotation has only the first
        node.create_subscription(Imu, "imu", cast(Any, on_imu), qos.SENSOR)
        node.create_subscription(
            ServoHealth, "servo_health", on_health, qos.SENSOR
        )
        limit = time.monotonic() + START_TIMEOUT
        spanned = 0.0  # s, from the first command to the last
        while spanned < warm_up + duration:
            executor.spin_once(timeout_sec=0.1)
            if (
                failure := processes.failed()
            ) or time.monotonic() > limit + duration:
                raise BenchmarkError(
                    f"the graph failed: {failure or 'no commands'}"
                )
            # a zero stamp means: no command
            stamps = list(filter(None, written))
            spanned = 1e-9 * (max(stamps) - min(stamps)) if stamps else 0.0
    begin = min(filter(None, written)) + warm_up * 1e9
    sampled = sorted(published)
    aged = [
        1e-9 * (at - published[sampled[k]])
        for s, at in written.items()
        if s > begin and (k := bisect_left(sampled, s)) < len(sampled)
    ]
    if not aged:
        raise BenchmarkError("no command after the warm-up")
    return np.array(aged)


@contextmanager
def busy_core() -> Iterator[None]:
    """Keep one core busy while the block runs."""
    with subprocess.Popen(
        [sys.executable, "-c", "while True: pass"]
    ) as process:
        try:
            yield
        finally:
            process.kill()


def row(found: Array, nodes: str) -> Row:
    """Percentiles of the ages of a walk."""
    shares = {"p50_ms": 50, "p90_ms": 90, "p99_ms": 99, "largest_ms": 100}
    ages = dict(zip(shares, 1e3 * np.percentile(found, list(shares.values()))))
    return {"kind": "age", "nodes": nodes, "commands": len(found)} | ages


def checks(rows: Sequence[Row]) -> list[Check]:
    """Checks: younger commands in one process, and the goals, which depend on the machine.

    Without the row of a walk its checks are missed.
    """
    by_nodes = {
        nodes: {"p50_ms": math.nan, "p99_ms": math.nan} for nodes in NODES
    }
    by_nodes |= {row["nodes"]: dict(row) for row in rows}
    composed, busy = by_nodes[COMPOSED], by_nodes[BUSY]
    ratio = composed["p50_ms"] / by_nodes[SEPARATE]["p50_ms"]
    median, oldest = GOALS.values()
    return [
        at_most(
            "median age of a command, composed over separate", ratio, AGE_RATIO
        ),
        at_most(
            "age of a command, composed, median",
            composed["p50_ms"],
            median,
            "ms",
        ),
        at_most(
            "age of a command, composed, p99", composed["p99_ms"], oldest, "ms"
        ),
        at_most(
            f"age of a command, {BUSY}, p99", busy["p99_ms"], BUSY_GOAL, "ms"
        ),
    ]


def draw(ages: Mapping[str, Array], path: Path) -> None:
    """Write the plot: share of the commands older than an age, by the nodes of the walk."""
    figure = Figure(figsize=(8.0, 4.2), layout="constrained")
    axes = figure.subplots()
    draw_longer(axes, {nodes: 1e3 * found for nodes, found in ages.items()})
    axes.plot(
        GOALS.values(),
        GOALS.keys(),
        "x",
        color=palette.SECONDARY,
        label="goals, composed",
    )
    axes.set(xlabel="from odometry published to goals written, ms")
    axes.legend(frameon=False, fontsize=8)
    figure.savefig(path, dpi=130)
