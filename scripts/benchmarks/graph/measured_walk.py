"""Runs of the graph as processes: metrics, ticks, CPU and memory of a walk; growth in a long one.

A long walk runs in lockstep with its recorder. Every `ENDURANCE_PERIOD` a sample is taken of each
node and of the machine's shared memory; the growth is from the first tenth after the warm-up to the
last tenth.
"""

import math
import os
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from benchmarks.harness import BenchmarkError, Check, Row, at_most, timed
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

STANDING = 1.0  # s, at most, from the first state to the first command
SAMPLE_PERIOD = 0.25  # s; the kernel counts CPU time in steps of 10 ms
ENDURANCE_PERIOD = 2.0  # s of wall time
# of the samples: kernels, buffers of the middleware and of Python fill
WARM_UP = 0.2
SHARED_MEMORY = Path("/dev/shm")
LARGEST_GROWTH = 1.0  # MB per node
# s; a process that has used its share of a period waits for the next one
QUOTA_PERIOD, QUOTA_POLL = 0.01, 0.0005
OVER_NODES = 90  # priority of the thread that stops them; theirs is 50
UNLIMITED = ("sim_robot", "recorder")  # not of the controller
GROWING = {"memory": "MB", "threads": "", "descriptors": ""}  # of a node


@dataclass(frozen=True)
class Walk:
    """Metrics, CPU and memory of one run of the graph."""

    metrics: WalkMetrics
    ticks: Ticks  # after the warm-up
    nodes: Sequence[str]
    cpu: Array  # (nodes,) percent of one core
    pss: Array  # (nodes,) MB, proportional set at the end
    replay_cpu: float  # s of CPU to replay a second of the bag
    replay_differences: int  # stages that are not replayed within `TOLERANCE`


def measure_walk(
    graph: Graph, values: Mapping[str, Any], duration: float, share: float = 0.0
) -> Walk:
    """Run the graph for `duration` (s) after the warm-up; raises BenchmarkError if it fails.

    share: of a core for each process of the controller, once the robot walks; 0: all that it takes.
    A robot that then stops, or is released, is no failure.
    """
    warm_up = read_record_settings().warm_up
    samples: list[list[float]] = []  # wall time, CPU of each node, s
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch, "bag")
        values = {**values, "bag": str(directory)}
        try:
            with (
                running(graph, values, Path(scratch, "logs")) as (
                    processes,
                    nodes,
                ),
                in_background(
                    lambda: samples.append(cpu_of(nodes)), SAMPLE_PERIOD
                ),
            ):
                watch(processes, STANDING)
                limited = [
                    process.pid
                    for name, process in nodes.items()
                    if share and name not in UNLIMITED
                ]
                with core_share(limited, share):
                    watch(processes, warm_up + duration, played=bool(limited))
                # counting shared pages takes the kernel too long for every sample
                pss = [
                    node.memory_full_info().pss / 1e6 for node in nodes.values()
                ]
            bag = Bag(directory)
            metrics = walk_metrics(bag, warm_up, read_servo())
            ticks = read_ticks(bag).after(read_motion(bag).t[0] + warm_up)
            replayed, seconds = timed(check_bag, bag, TOLERANCE)
        except (RunError, BagError, psutil.Error) as error:
            raise BenchmarkError(f"the graph failed: {error}") from error
        span = to_seconds(bag.end_ns) - ticks.end + ticks.time[[0, -1], 0]
        replay_cpu = seconds / (1e-9 * bag.duration_ns)
    at, *columns = np.array(samples).T
    span = np.clip(span, at[0], at[-1])
    used = [np.diff(np.interp(span, at, column))[0] for column in columns]
    return Walk(
        metrics,
        ticks,
        list(nodes),
        100 * np.array(used) / np.diff(span),
        np.array(pss),
        replay_cpu,
        sum(stage.first is not None for stage in replayed),
    )


def long_walk(
    graph: Graph, values: Mapping[str, Any], duration: float
) -> list[Row]:
    """Walk in lockstep for `duration` (s of graph time) and return the growth of every node.

    Raises BenchmarkError if the graph fails. Its bag is deleted: 0.2 MB a second.
    """
    samples: list[
        list[list[float]]
    ] = []  # MB, threads, descriptors of each node
    shared: list[float] = []  # MB

    def sample() -> None:
        samples.append(
            [
                [p.memory_full_info().uss / 1e6, p.num_threads(), p.num_fds()]
                for p in nodes.values()
            ]
        )
        shared.append(
            sum(f.stat().st_size for f in SHARED_MEMORY.iterdir()) / 1e6
        )

    with tempfile.TemporaryDirectory() as scratch:
        values = {**values, "lockstep": True, "bag": str(Path(scratch, "bag"))}
        try:
            with (
                running(graph, values, Path(scratch, "logs")) as (
                    processes,
                    nodes,
                ),
                in_background(sample, ENDURANCE_PERIOD),
            ):
                watch(processes, duration)
        except RunError as error:
            raise BenchmarkError(f"the graph failed: {error}") from error
    counted = {"kind": "endurance", "duration_s": duration}
    return [
        *(
            counted | {"node": name} | dict(zip(GROWING, growth.tolist()))
            for name, growth in zip(nodes, grown(np.array(samples)))
        ),
        counted | {"kind": "shared", "memory": grown(np.array(shared))},
    ]


def grown(samples: Array) -> Array:
    """Growth (...) of samples (n, ...): medians of the last tenth less the first."""
    count = len(samples)
    begin, tenth = (
        int(WARM_UP * count),
        max(1, int((1.0 - WARM_UP) * count / 10)),
    )
    early, late = samples[begin : begin + tenth], samples[count - tenth :]
    return np.median(late, axis=0) - np.median(early, axis=0)


def endurance_checks(rows: Sequence[Row]) -> list[Check]:
    """The growth of the worst node against its limits; none if there was no long walk."""
    found = [row for row in rows if row["kind"] in ("endurance", "shared")]
    if not found:
        return []
    *nodes, shared = found
    checks = [
        at_most(
            f"growth of a node's {what} in a long walk",
            max(row[what] for row in nodes),
            LARGEST_GROWTH if unit else 0.0,
            unit,
        )
        for what, unit in GROWING.items()
    ]
    return [
        *checks,
        at_most(
            "growth of shared memory in a long walk",
            shared["memory"],
            0.0,
            "MB",
        ),
    ]


@contextmanager
def running(
    graph: Graph, values: Mapping[str, Any], logs: Path
) -> Iterator[tuple[Any, dict[str, psutil.Process]]]:
    """The graph while the block runs: its processes, and psutil's by node."""
    with started(graph, values, logs) as processes:
        names = [spec.name for spec in graph.nodes(values)]
        yield (
            processes,
            {name: psutil.Process(processes.pid(name)) for name in names},
        )


@contextmanager
def core_share(pids: Sequence[int], share: float) -> Iterator[None]:
    """Give each process a share of a core while the block runs, by SIGSTOP and SIGCONT.

    It is as under a quota of the kernel, which needs a control group that can be written: CPU time
    that a period leaves is lost, and what a process uses beyond its quota is taken off the next one.
    """
    limits = dict.fromkeys(pids, math.inf)  # s, CPU time at which it stops
    period = 0

    def limit() -> None:
        nonlocal period
        if not period:
            with suppress(PermissionError):
                os.sched_setscheduler(
                    0, os.SCHED_FIFO, os.sched_param(OVER_NODES)
                )
        before, period = period, int(time.monotonic() / QUOTA_PERIOD)
        for pid in pids:
            used = time.clock_gettime(~pid << 3 | 2)  # clock_getcpuclockid(3)
            if period > before:
                limits[pid] = min(limits[pid], used) + share * QUOTA_PERIOD
            runs = used < limits[pid]
            os.kill(pid, signal.SIGCONT if runs else signal.SIGSTOP)

    try:
        with in_background(limit, QUOTA_POLL) if pids else nullcontext():
            yield
    finally:
        for pid in pids:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)


@contextmanager
def in_background(
    sample: Callable[[], object], period: float
) -> Iterator[None]:
    """Call `sample` each `period` (s) on a thread while the block runs and all nodes live."""
    ended = threading.Event()

    def sample_until_ended() -> None:
        # a node has ended: `watch` reports which
        with suppress(psutil.Error, OSError):
            sample()
            while not ended.wait(period):
                sample()

    thread = threading.Thread(target=sample_until_ended, daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def cpu_of(nodes: Mapping[str, psutil.Process]) -> list[float]:
    """Wall time and CPU time of each node, s; raises psutil.Error without a node."""
    cpu = [sum(process.cpu_times()[:2]) for process in nodes.values()]
    return [time.time(), *cpu]
