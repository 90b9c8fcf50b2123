"""One run of the graph, as processes, with its bag: metrics, ticks, CPU and memory."""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.graph.usage import Usage, metered
from benchmarks.harness import BenchmarkError, timed
from slot_bringup.graph import Graph
from slot_bringup.monitor import RunError, watch
from slot_bringup.run import started
from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_core.dynamics.servo import read_servo
from slot_core.recording.record_settings import read_record_settings
from slot_lab.bags.bag import Bag, BagError
from slot_lab.bags.check_bag import check_bag
from slot_lab.bags.recorded_walk import Ticks, read_motion, read_ticks
from slot_lab.bags.replay_command import TOLERANCE
from slot_lab.report.metrics import WalkMetrics, walk_metrics

STANDING = (
    1.0  # s, at most, from the first state to the first command: the robot stands still
)


@dataclass(frozen=True)
class Walk:
    """Metrics, CPU and memory of one run of the graph."""

    metrics: WalkMetrics
    ticks: Ticks  # after the warm-up
    cpu: Array  # (nodes,) percent of one core
    waited: float  # % of the time in which any program on the machine waited for a core
    usage: Usage
    replay_cpu: float  # s of CPU to replay a second of the bag
    replay_differences: int  # stages that are not replayed within `TOLERANCE`


def measure_walk(graph: Graph, values: Mapping[str, Any], duration: float) -> Walk:
    """Run the graph for `duration` (s) after the warm-up; raises BenchmarkError if it fails."""
    warm_up = read_record_settings().warm_up
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch, "bag")
        try:
            usage = record(
                graph, {**values, "bag": str(directory)}, STANDING + warm_up + duration
            )
            bag = Bag(directory)
            metrics = walk_metrics(bag, warm_up, read_servo())
            ticks = read_ticks(bag).after(read_motion(bag).t[0] + warm_up)
            replayed, seconds = timed(check_bag, bag, TOLERANCE)
            replay_cpu = seconds / (1e-9 * bag.duration_ns)
        except (RunError, BagError, psutil.Error) as error:
            raise BenchmarkError(f"the graph failed: {error}") from error
        begin, end = to_seconds(bag.end_ns) - ticks.end + ticks.time[[0, -1], 0]
    *cpu, waiting = usage.percent(begin, end)
    differences = sum(stage.first is not None for stage in replayed)
    return Walk(metrics, ticks, np.array(cpu), waiting, usage, replay_cpu, differences)


def record(graph: Graph, values: Mapping[str, Any], duration: float) -> Usage:
    """Run the graph until its clock has advanced by `duration` (s); raises RunError."""
    names = [spec.name for spec in graph.nodes(values)]
    with (
        tempfile.TemporaryDirectory() as logs,
        started(graph, values, Path(logs)) as processes,
    ):
        with metered({name: processes.pid(name) for name in names}) as usage:
            watch(processes, duration)
        return usage
