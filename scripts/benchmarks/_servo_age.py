"""The age of a command at the servos: all nodes as processes, emulated servos, real time.

From the publication of an odometry reading to the moment when the goals that follow from it have
been handed to the port. The delay of the odometry itself is the sensor's and not counted; the time
of the bytes on the wire is 0.34 ms at 1 Mbaud for four goals and not counted either.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from slot_bringup.graph import read_graph
from slot_bringup.monitor import RunError, watch
from slot_bringup.run import started
from slot_core import decode
from slot_core.evaluation.bag import Bag, BagError, read_record_settings
from slot_core.evaluation.benchmark import BenchmarkError, Check, at_most
from slot_core.evaluation.palette import INK, SECOND

AGE_GOAL = 8.0  # ms, of the 99th percentile

Ages = npt.NDArray[np.float64]


def walk(duration: float) -> Ages:
    """Ages (s) of every command of a walk, the warm-up left out; raises BenchmarkError."""
    graph, warm_up = read_graph(), read_record_settings().warm_up
    values = {argument.name: argument.default for argument in graph.arguments}
    with tempfile.TemporaryDirectory() as scratch:
        bag, logs = Path(scratch, "bag"), Path(scratch, "log")
        values |= {"hardware": "fake_bus", "bag": str(bag)}
        try:
            with started(graph, values, logs) as processes:
                watch(processes, warm_up + duration)
            return ages(Bag(bag), warm_up)
        except (RunError, BagError) as error:
            raise BenchmarkError(f"the graph did not walk: {error}") from error


def ages(bag: Bag, warm_up: float) -> Ages:
    """From an odometry's publication to its goals written, s, in the order of time.

    `warm_up` (s) counts from the first goals.
    """
    published = {decode.stamp(odom): time for time, odom in bag.messages("/odom")}
    written: dict[int, int] = {}
    for _, health in bag.messages("/servo_health"):
        written.setdefault(decode.time(health.commanded), decode.time(health.written))
    written.pop(0, None)  # before the first command
    begin = min(written.values()) + warm_up * 1e9
    return np.array(
        [1e-9 * (at - published[stamp]) for stamp, at in written.items() if at >= begin]
    )


def row(found: Ages) -> dict[str, Any]:
    """Percentiles of the ages."""
    p50, p90, p99 = 1e3 * np.percentile(found, [50, 90, 99])
    return {
        "kind": "age",
        "commands": len(found),
        "p50_ms": p50,
        "p90_ms": p90,
        "p99_ms": p99,
        "largest_ms": 1e3 * found.max(),
    }


def checks(found: dict[str, Any]) -> list[Check]:
    """The age against its goal."""
    return [at_most("age of a command at the servos, p99", found["p99_ms"], AGE_GOAL, "ms")]


def draw(found: Ages, path: Path) -> None:
    """Share of the commands that are older than an age."""
    figure = Figure(figsize=(6.0, 3.4), layout="constrained")
    axes = figure.subplots()
    axes.step(1e3 * np.sort(found), 1.0 - np.arange(len(found)) / len(found), color=INK)
    axes.axvline(AGE_GOAL, color=SECOND, linestyle=":", label=f"goal for 1 %: {AGE_GOAL:g} ms")
    axes.axhline(0.01, color=SECOND, linestyle=":")
    axes.set(
        xlabel="from odometry published to goals written, ms",
        ylabel="share of commands that are older",
        yscale="log",
        xlim=(0.0, None),
    )
    axes.grid(alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=150)
