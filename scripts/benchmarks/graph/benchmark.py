"""Latency, CPU and memory of all nodes as processes in real time; speed in lockstep.

The graph walks in real time with its bag; once in lockstep; and once without ROS in one process,
as a reference for the time that the algorithms take. Percentages of CPU are of one core. The
warm-up of `config/record.yaml` is left out of every figure.
"""

import statistics
import time
from collections import defaultdict, deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from benchmarks.graph.measured_walk import Walk, measure_walk
from benchmarks.graph.picture import END_TO_END, draw
from benchmarks.harness import Check, Row, at_least, at_most, cpu_time
from slot_bringup.graph import read_graph
from slot_core.bags import decode
from slot_core.control.mpc.mpc import Mpc, read_mpc
from slot_core.control.pace import Pace
from slot_core.dynamics.scene import read_scene
from slot_core.report.metrics import Latency
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_msgs.msg import GaitPreview, MpcState
from slot_nodes import messages

BLOCK = 30  # ticks of the closed loop per repeat, about a second
CYCLES, CYCLE_MS = 120, 2.0  # cycles of the MPC's node, goal of their median
WHOLE = "all nodes"
NODE_FIGURES = ("cpu_percent", "rss_mb", "pss_mb")

# A command later than a period arrives after the next odometry reading and is outdated. Half of the
# period in 99 of 100 ticks leaves the other half for a processor of the robot that is half as fast.
PERIOD_SHARE_P99 = 0.5
# All nodes of one graph must fit on one core, so that none waits for another on the robot's six.
CPU_PERCENT = 100.0
# A tenth of the robot's 8 GB. A page that n nodes share counts 1/n in each.
PSS_MB = 800.0
# Error of the real-time factor: the simulated clock is the wall clock, so an error beyond jitter
# means that the simulation falls behind.
REAL_TIME_ERROR = 0.01
# Plausibility of the walk: the figures of a robot that fell do not count.
LEAST_SPEED, LARGEST_TILT = 0.05, 0.5  # m/s; rad, where a supervisor would stop the robot
# Lockstep is for tests and must not be slower than real time. One process pays for no messages; the
# simulated robot may take a tenth of real time, and the controller as much again.
LOCKSTEP_SPEED, LOOP_CPU = 1.0, 0.2


@dataclass(frozen=True)
class Plan:
    """Repeats and durations of the benchmark."""

    repeats: int
    duration: float  # s of each walk in real time, after the warm-up
    lockstep: float  # s of graph time, after the warm-up
    blocks: int  # repeats of the closed loop


QUICK, FULL = Plan(1, 15.0, 10.0, 5), Plan(3, 60.0, 30.0, 20)


def run(quick: bool, out: Path, progress: Callable[[str], None]) -> tuple[list[Row], list[Check]]:
    """Run the graph as `QUICK` or `FULL` plans; the picture goes to `out/graph.png`."""
    plan = QUICK if quick else FULL
    graph = read_graph()
    values = {argument.name: argument.default for argument in graph.arguments}
    progress("closed loop in one process")
    loop = closed_loop_row(values, plan.blocks)  # also compiles the kernels that the nodes load
    progress("cycle of the MPC's node")
    cycle = cycle_row(CYCLES)
    progress("lockstep")
    lockstep = measure_walk(graph, values | {"lockstep": True}, plan.lockstep)
    walks = []
    for repeat in range(plan.repeats):
        progress(f"real time, {repeat + 1} of {plan.repeats}")
        walks.append(measure_walk(graph, values, plan.duration))
    draw(walks, out / "graph.png")
    rows = [row for repeat, one in enumerate(walks) for row in walk_rows(repeat, one)]
    rows += medians(rows)
    speed = lockstep.metrics.real_time_factor
    rows += [
        {"kind": "lockstep", "duration_s": lockstep.metrics.duration, "speed": speed},
        loop,
        cycle,
    ]
    return rows, checks(rows, plan, walks[0].metrics.period)


def cycle_row(ticks: int) -> dict[str, Any]:
    """Time of the MPC node's cycle, serialized inputs to serialized output; no DDS."""
    loop, period = ClosedLoop("flat", "walk", None, 0), read_scene("flat").sensors.odometry.period
    walk = [
        (messages.preview_to_msg(tick.preview), messages.state_to_msg(tick.estimate))
        for tick in loop.run(ticks)
    ]
    inputs = [tuple(map(serialize_message, pair)) for pair in walk]
    mpc, elapsed, cpu = Mpc(read_robot(), read_mpc(), time.perf_counter), [], []
    for preview, state in inputs:
        time.sleep(period)
        start, busy = time.perf_counter(), time.process_time()
        stamp, x, *_ = decode.state(deserialize_message(state, MpcState))
        result = mpc.step(x, decode.preview(deserialize_message(preview, GaitPreview)))
        serialize_message(messages.forces_to_msg(stamp, result, Pace()))
        elapsed.append(time.perf_counter() - start)
        cpu.append(time.process_time() - busy)
    return {
        "kind": "cycle",
        "median_ms": 1e3 * np.median(elapsed),
        "p99_ms": 1e3 * np.percentile(elapsed, 99),
        "cpu_ms": 1e3 * np.median(cpu),
    }


def closed_loop_row(values: Mapping[str, Any], blocks: int) -> Row:
    """CPU time of controller and simulated robot in one process, per second of graph time."""
    loop = ClosedLoop(values["scene"], values["gait"], None, values["seed"])
    ticks = loop.run((blocks + 1) * BLOCK)  # the first one warms up
    figure = cpu_time(lambda: deque(islice(ticks, BLOCK), maxlen=0), blocks)
    duration = BLOCK * read_scene(values["scene"]).sensors.odometry.period
    return {
        "kind": "closed loop",
        "duration_s": blocks * duration,
        "cpu_s_per_s": figure.median / duration,
        "cpu_s_per_s_least": figure.least / duration,
        "cpu_s_per_s_largest": figure.largest / duration,
        "speed": duration / figure.median,
    }


def walk_rows(repeat: int, one: Walk) -> list[Row]:
    """Rows of one walk: its metrics, every stage, every node."""
    m = one.metrics
    stages = {**m.stages, END_TO_END: m.end_to_end}
    figures = np.column_stack([one.cpu, *(np.divide([one.usage.rss, one.usage.pss], 1e6))])
    nodes = [*zip(one.usage.nodes, figures), (WHOLE, figures.sum(axis=0))]
    return [
        {
            "kind": "walk",
            "repeat": repeat,
            "duration_s": m.duration,
            "period_ms": 1e3 * m.period,
            "ticks": m.ticks,
            "deadline_misses": m.deadline_misses,
            "unanswered": m.unanswered,
            "missed_ticks": m.missed_ticks,
            "real_time_factor": m.real_time_factor,
            "mean_v_x": m.mean_v_x,
            "tilt_max_rad": m.tilt_max,
            "fallback_cycles": m.fallback_cycles,
            "waiting_for_a_core_percent": one.waited,  # how loaded the machine was
        },
        *({"kind": "latency", "repeat": repeat, "stage": s} | in_ms(v) for s, v in stages.items()),
        *(
            {"kind": "node", "repeat": repeat, "node": node} | dict(zip(NODE_FIGURES, values))
            for node, values in nodes
        ),
    ]


def in_ms(latency: Latency) -> dict[str, float]:
    """Percentiles of a latency in ms."""
    figures = {"p50_ms": latency.p50, "p99_ms": latency.p99, "max_ms": latency.max}
    return {name: 1e3 * value for name, value in figures.items()}


def medians(rows: Sequence[Row]) -> list[Row]:
    """One row for each kind, stage and node: the median of every number over the repeats."""
    groups: dict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in rows:
        groups[tuple(value for value in row.values() if isinstance(value, str))].append(row)
    return [
        {
            name: value if isinstance(value, str) else statistics.median(r[name] for r in group)
            for name, value in group[0].items()
        }
        | {"repeat": "median"}
        for group in groups.values()
    ]


def checks(rows: Sequence[Row], plan: Plan, period: float) -> list[Check]:
    """The figures against their goals: median of latency and CPU, worst repeat of the rest."""

    def column(name: str, **which: Any) -> list[Any]:
        return [r[name] for r in rows if which.items() <= r.items() and name in r]

    def over_repeats(name: str, kind: str = "walk", **which: Any) -> list[Any]:
        return [v for k in range(plan.repeats) for v in column(name, kind=kind, repeat=k, **which)]

    [p99] = column("p99_ms", stage=END_TO_END, repeat="median")
    [cpu] = column("cpu_percent", node=WHOLE, repeat="median")
    error = max(abs(factor - 1) for factor in over_repeats("real_time_factor"))
    return [
        at_most("end to end p99", p99, 1e3 * PERIOD_SHARE_P99 * period, "ms"),
        at_most("deadline misses", sum(over_repeats("deadline_misses")), 0, "ticks"),
        at_most("ticks without a command", sum(over_repeats("unanswered")), 0, "ticks"),
        at_most("missing odometry readings", sum(over_repeats("missed_ticks")), 0, "ticks"),
        at_most("real-time factor off 1", 100 * error, 100 * REAL_TIME_ERROR, "%"),
        at_least("shortest walk", min(over_repeats("duration_s")), plan.duration, "s"),
        at_least("least mean v_x", min(over_repeats("mean_v_x")), LEAST_SPEED, "m/s"),
        at_most("largest tilt", max(over_repeats("tilt_max_rad")), LARGEST_TILT, "rad"),
        at_most("CPU of all nodes", cpu, CPU_PERCENT, "% of one core"),
        at_most(
            "memory of all nodes", max(over_repeats("pss_mb", "node", node=WHOLE)), PSS_MB, "MB"
        ),
        at_most("cycle of the MPC's node", column("median_ms", kind="cycle")[0], CYCLE_MS, "ms"),
        at_most(
            "CPU of the MPC's node at 200 Hz",
            20.0 * column("cpu_ms", kind="cycle")[0],
            100.0,
            "% of a core",
        ),
        at_least("lockstep speed", column("speed", kind="lockstep")[0], LOCKSTEP_SPEED, "x"),
        at_most("closed loop CPU", column("cpu_s_per_s")[0], LOOP_CPU, "s per s"),
    ]
