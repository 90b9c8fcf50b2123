"""Latency, CPU and memory of the graph in real time, and its speed in lockstep.

The graph walks with its bag, its controller's nodes as separate processes and composed in one, in
real time, composed also with odometry at 100 Hz, and in lockstep; and without ROS, controller and
robot in one process, as a reference for the time that the algorithms take. A long walk in lockstep
shows what grows. Percentages of CPU are of one core. The warm-up of `config/record.yaml` is left
out of every figure.
"""

import math
import statistics
import time
from collections import defaultdict, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message

from benchmarks import against as other_checkout
from benchmarks.graph.endurance import endurance_checks, long_walk
from benchmarks.graph.measured_walk import Walk, measure_walk
from benchmarks.graph.plots import END_TO_END, draw
from benchmarks.harness import (
    Attempts,
    Check,
    Progress,
    Row,
    at_least,
    at_most,
    cpu_time,
    timed,
)
from slot_bringup.graph import CONTROLLER, read_graph
from slot_core.control.pace import Pace
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.control.policy import make_policy
from slot_core.dynamics.scene import read_scene
from slot_core.messages import decode
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_lab.bags.recorded_walk import STAGES
from slot_msgs.msg import GaitPreview, MpcState
from slot_nodes import messages

BLOCK = 30  # ticks of the closed loop per repeat, about a second
CYCLES = 120  # of the MPC's node
ALL_NODES, RECORDER = "all nodes", "recorder"
SEPARATE, COMPOSED = "separate", "composed"  # the controller's nodes
FAST = "composed, 100 Hz"  # odometry; else it is at 30 Hz
NODE_FIGURES = ("cpu_percent", "rss_mb", "pss_mb")
PERCENTILES = ("p50", "p99", "max")  # of a latency
WALK_FIGURES = (
    "ticks",
    "deadline_misses",
    "unanswered",
    "missed_ticks",
    "real_time_factor",
)
WALK_FIGURES += ("mean_v_x", "fallback_cycles")

# Composed, as on the robot: a thirteenth of its 8 GB. A page that n processes share counts 1/n in
# each.
PSS_MB, CONTROLLER_PSS_MB = 600.0, 250.0
# Plausibility of the walk: the figures of a robot that fell do not count.
LEAST_SPEED, LARGEST_TILT = (
    0.05,
    0.5,
)  # m/s; rad, where a supervisor would stop the robot
# What composition saves at the least, against separate processes in the same run.
# In lockstep robot and supervisor are in the process too.
LATENCY_RATIO, CPU_RATIO, LEAST_SPEEDUP = 0.8, 0.8, 1.5
# CPU of the controller with odometry at 100 Hz over that at 30 Hz: 3.3 if a tick takes as long.
FAST_CPU_RATIO = 3.4
REPLAY_RATIO = (
    2.0  # CPU of a replay, without start-up, over that of controller and plant
)
REPLAYED = 60.0  # s of a walk
# Goals for the robot, which are the machine's too.
CONTROLLER_CPU, RECORDER_CPU = 30.0, 5.0  # % of a core, at 30 Hz
FEEDBACK_CPU, POLICY_CPU = 0.5, 4.0  # ms, of the policy: after the odometry, and in all
LOCKSTEP_SPEED = 8.0  # times real time, composed
REPLAY_CPU = 3.0  # s, of `REPLAYED`, without start-up
LARGEST_CYCLE = (
    3.0  # CPU of a cycle of the MPC's node, messages included, over its solution alone
)


@dataclass(frozen=True)
class Plan:
    """Repeats and durations of the benchmark."""

    repeats: int
    duration: float  # s of each walk in real time, after the warm-up
    lockstep: float  # s of graph time, after the warm-up
    blocks: int  # repeats of the closed loop
    endurance: float  # s of graph time of the long walk


QUICK, FULL = Plan(1, 10.0, 10.0, 5, 0.0), Plan(3, 60.0, 30.0, 20, 3600.0)


def run(
    quick: bool,
    out: Path,
    progress: Progress,
    endurance: float | None = None,
    against: Path | None = None,
) -> tuple[list[Row], list[Check]]:
    """Run the graph as `QUICK` or `FULL` plans; the plot goes to `out/graph.png`."""
    plan = QUICK if quick else FULL
    graph = read_graph()
    values = {argument.name: argument.default for argument in graph.arguments}
    progress("closed loop in one process")
    loop = closed_loop_row(
        values, plan.blocks
    )  # also compiles the kernels that the nodes load
    progress("cycle of the MPC's node")
    cycle = cycle_row(CYCLES)
    modes = {SEPARATE: values, COMPOSED: values | {"composed": True}}
    speeds, attempts = [], Attempts()
    for mode, chosen in modes.items():
        progress(name := f"lockstep, {mode}")
        values_here = chosen | {"lockstep": True}
        if one := attempts.run(name, measure_walk, graph, values_here, plan.lockstep):
            figures = {
                "duration_s": one.metrics.duration,
                "speed": one.metrics.real_time_factor,
            }
            speeds.append({"kind": "lockstep", "nodes": mode} | figures)
    modes[FAST] = modes[COMPOSED] | {"scene": "fast_odometry"}
    walks: dict[str, list[Walk]] = {mode: [] for mode in modes}
    for repeat in range(plan.repeats):
        for mode, chosen in modes.items():
            progress(name := f"real time, {mode}, {repeat + 1} of {plan.repeats}")
            if one := attempts.run(name, measure_walk, graph, chosen, plan.duration):
                walks[mode].append(one)
    if walks[SEPARATE] and walks[COMPOSED]:
        draw(walks[SEPARATE], walks[COMPOSED], out / "graph.png")
    rows = []
    for mode, some in walks.items():
        for repeat, one in enumerate(some):
            rows += walk_rows(mode, repeat, one)
    rows += medians(rows)
    rows += [*speeds, loop, cycle]
    duration = plan.endurance if endurance is None else endurance
    if duration > 0.0:
        progress(f"long walk in lockstep, {duration:g} s")
        composed = values | {"composed": True}
        rows += attempts.run("long walk", long_walk, graph, composed, duration) or []
    if against is not None:
        progress("another checkout")
        rows += other_checkout.against_rows(against)
    found = [
        *other_checkout.against_checks(rows),
        *checks(rows, plan),
        *goal_checks(rows),
        *endurance_checks(rows),
    ]
    return [*rows, *attempts.rows], [*found, *attempts.checks]


def cycle_row(ticks: int) -> dict[str, Any]:
    """Time of the MPC node's cycle in the walk, serialized inputs to serialized output; no DDS.

    The preparation for the next cycle has a time of its own.
    """
    loop, period = (
        ClosedLoop("flat", "walk", None, 0),
        read_scene("flat").sensors.odometry.period,
    )
    walking = [
        (messages.preview_to_msg(tick.preview), messages.state_to_msg(tick.estimate))
        for tick in loop.run(ticks)
    ]
    inputs = [tuple(map(serialize_message, pair)) for pair in walking]
    policy = make_policy(DEFAULT_POLICY, read_robot())
    elapsed, cpu, alone, preparing = [], [], [], []
    for preview, state in inputs:
        time.sleep(period)
        start, busy = time.perf_counter(), time.process_time()
        estimate = decode.estimate(deserialize_message(state, MpcState))
        ahead = decode.preview(deserialize_message(preview, GaitPreview))
        plan, seconds = timed(policy.step, estimate, ahead)
        alone.append(seconds)
        serialize_message(messages.plan_to_msg(plan, ahead, 0.0, Pace()))
        elapsed.append(time.perf_counter() - start)
        cpu.append(time.process_time() - busy)
        preparing.append(timed(policy.prepare)[1])
    row = {"kind": "cycle", "p99_ms": 1e3 * np.percentile(elapsed, 99)}
    times = {"median_ms": elapsed, "cpu_ms": cpu}
    times |= {"solve_cpu_ms": alone, "prepare_cpu_ms": preparing}
    return row | {name: 1e3 * np.median(values) for name, values in times.items()}


def closed_loop_row(values: Mapping[str, Any], blocks: int) -> Row:
    """CPU time of controller and simulated robot in one process, per second of graph time."""
    loop = ClosedLoop(values["scene"], values["gait"], None, values["seed"])
    ticks = loop.run((blocks + 1) * BLOCK)  # the first one warms up
    figure = cpu_time(lambda: deque(islice(ticks, BLOCK), maxlen=0), blocks)
    duration = BLOCK * read_scene(values["scene"]).sensors.odometry.period
    seconds = {"": figure.median, "_least": figure.least, "_largest": figure.largest}
    row = {"kind": "closed loop", "duration_s": blocks * duration}
    row |= {f"cpu_s_per_s{name}": value / duration for name, value in seconds.items()}
    return row | {"speed": duration / figure.median}


def walk_rows(mode: str, repeat: int, one: Walk) -> list[Row]:
    """Rows of one walk: its metrics, every stage, every node."""
    which = {"nodes": mode, "repeat": repeat}
    m = one.metrics
    stages = {**m.stages, END_TO_END: m.end_to_end}
    figures = np.column_stack(
        [one.cpu, *(np.divide([one.usage.rss, one.usage.pss], 1e6))]
    )
    nodes = [*zip(one.usage.nodes, figures), (ALL_NODES, figures.sum(axis=0))]
    walk = {
        "kind": "walk",
        **which,
        "duration_s": m.duration,
        "period_ms": 1e3 * m.period,
    }
    walk |= {name: getattr(m, name) for name in WALK_FIGURES} | {
        "tilt_max_rad": m.tilt_max
    }
    walk["waiting_for_a_core_percent"] = one.waited  # how loaded the machine was
    walk |= {
        "replay_cpu_s_per_s": one.replay_cpu,
        "replay_differences": one.replay_differences,
    }
    node, latency = {"kind": "node", **which}, {"kind": "latency", **which}
    return [
        walk,
        *(
            latency
            | {"stage": stage}
            | {f"{p}_ms": 1e3 * getattr(found, p) for p in PERCENTILES}
            for stage, found in stages.items()
        ),
        *(
            node | {"node": name} | dict(zip(NODE_FIGURES, values))
            for name, values in nodes
        ),
    ]


def medians(rows: Sequence[Row]) -> list[Row]:
    """One row for each kind, stage and node: the median of every number over the repeats."""
    groups: dict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in rows:
        groups[tuple(value for value in row.values() if isinstance(value, str))].append(
            row
        )
    return [
        {
            name: value
            if isinstance(value, str)
            else statistics.median(r[name] for r in group)
            for name, value in group[0].items()
        }
        | {"repeat": "median"}
        for group in groups.values()
    ]


def checks(rows: Sequence[Row], plan: Plan) -> list[Check]:
    """The figures against their goals: median of the CPU, worst repeat of the rest.

    Latencies to the command are rows without a check; those to the servo have theirs in `servo`.
    CPU and speed of the graph beside one process have none either, as its kernels gain more by a
    quicker processor than messages do. Without the rows of a walk its checks are missed.
    """

    def column(name: str, **which: Any) -> list[Any]:
        return [r[name] for r in rows if which.items() <= r.items() and name in r]

    def over_repeats(name: str, kind: str = "walk", **which: Any) -> list[Any]:
        return [
            v
            for k in range(plan.repeats)
            for v in column(name, kind=kind, repeat=k, **which)
        ]

    def median(name: str, mode: str, **which: Any) -> float:
        return only(column(name, nodes=mode, repeat="median", **which))

    def only(values: list[Any]) -> float:
        return values[0] if values else math.nan

    stages = sum(median("cpu_percent", SEPARATE, node=node) for node in STAGES)
    controller = median("cpu_percent", COMPOSED, node=CONTROLLER)
    age = {
        mode: median("p50_ms", mode, stage=END_TO_END) for mode in (SEPARATE, COMPOSED)
    }
    [cycle] = (row for row in rows if row["kind"] == "cycle")
    [loop] = column("cpu_s_per_s", kind="closed loop")
    separate, composed = (
        only(column("speed", kind="lockstep", nodes=mode))
        for mode in (SEPARATE, COMPOSED)
    )
    nodes, own = (
        max(over_repeats("pss_mb", "node", nodes=COMPOSED, node=node), default=math.nan)
        for node in (ALL_NODES, CONTROLLER)
    )
    solving = cycle["cpu_ms"] / cycle["solve_cpu_ms"]
    replay = median("replay_cpu_s_per_s", SEPARATE, kind="walk") / loop
    fast = median("cpu_percent", FAST, node=CONTROLLER) / controller
    younger, beside = age[COMPOSED] / age[SEPARATE], "composed over separate"
    return [
        at_least(
            "shortest walk",
            min(over_repeats("duration_s"), default=math.nan),
            plan.duration,
            "s",
        ),
        at_least(
            "least mean v_x",
            min(over_repeats("mean_v_x"), default=math.nan),
            LEAST_SPEED,
            "m/s",
        ),
        at_most(
            "largest tilt",
            max(over_repeats("tilt_max_rad"), default=math.nan),
            LARGEST_TILT,
            "rad",
        ),
        at_most("memory of all nodes, composed", nodes, PSS_MB, "MB"),
        at_most("memory of the controller, composed", own, CONTROLLER_PSS_MB, "MB"),
        at_most(
            "CPU of a cycle of the MPC's node over its solution's",
            solving,
            LARGEST_CYCLE,
        ),
        at_most(f"{beside}: odometry to command, median", younger, LATENCY_RATIO),
        at_most(f"{beside}: CPU of the controller", controller / stages, CPU_RATIO),
        at_least(f"{beside}: lockstep speed", composed / separate, LEAST_SPEEDUP),
        at_most(
            "CPU of a replay over that of controller and plant", replay, REPLAY_RATIO
        ),
        at_most(
            "stages that a replay changes",
            max(over_repeats("replay_differences"), default=math.nan),
            0,
        ),
        at_most("100 Hz over 30 Hz: CPU of the controller", fast, FAST_CPU_RATIO),
    ]


def goal_checks(rows: Sequence[Row]) -> list[Check]:
    """The goals for the robot, which depend on the speed of the machine."""

    def largest(name: str, **which: Any) -> float:
        found = (r[name] for r in rows if which.items() <= r.items() and name in r)
        return max(found, default=math.nan)

    controller = largest(
        "cpu_percent", nodes=COMPOSED, node=CONTROLLER, repeat="median"
    )
    recorder = largest("cpu_percent", nodes=SEPARATE, node=RECORDER, repeat="median")
    solve, prepare = (
        largest(f"{phase}_cpu_ms", kind="cycle") for phase in ("solve", "prepare")
    )
    speed = largest("speed", kind="lockstep", nodes=COMPOSED)
    replay_cpu = largest("replay_cpu_s_per_s", nodes=SEPARATE, repeat="median")
    return [
        at_most("CPU of the policy's feedback phase", solve, FEEDBACK_CPU, "ms"),
        at_most("CPU of the policy in a tick", solve + prepare, POLICY_CPU, "ms"),
        at_most("CPU of the controller, composed", controller, CONTROLLER_CPU, "%"),
        at_most("CPU of the recorder", recorder, RECORDER_CPU, "%"),
        at_most(
            "100 Hz: ticks without a command", largest("unanswered", nodes=FAST), 0
        ),
        at_least("lockstep speed, composed", speed, LOCKSTEP_SPEED, "times real time"),
        at_most("CPU of a replay of 60 s", REPLAYED * replay_cpu, REPLAY_CPU, "s"),
    ]
