"""Latency, CPU and memory of the graph in real time, and its speed in lockstep.

The graph walks with its bag, its controller's nodes as separate processes and composed in one, in
real time, composed also with odometry at 100 Hz, and in lockstep; in real time also with a share of
a core for each process of the controller, the simulation apart; and without ROS, controller and
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
from itertools import islice, product
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rclpy.serialization import deserialize_message, serialize_message

from benchmarks.graph.measured_walk import (
    Walk,
    endurance_checks,
    long_walk,
    measure_walk,
)
from benchmarks.harness import (
    Attempts,
    Check,
    Outcome,
    Progress,
    Row,
    at_least,
    at_most,
    cpu_time,
    timed,
)
from benchmarks.plots import draw_longer
from slot_bringup.graph import CONTROLLER, read_graph
from slot_core.arrays import Array
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.control.policy import make_policy
from slot_core.drawing import palette
from slot_core.gait.gait import read_gaits
from slot_core.messages import decode
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_lab.bags.recorded_walk import STAGES
from slot_msgs.msg import GaitPreview, MpcState
from slot_nodes import messages
from slot_nodes.pace import Pace

BLOCK = 30  # ticks of the closed loop per repeat, about a second
CYCLES = 120  # of the MPC's node
ALL_NODES, RECORDER = "all nodes", "recorder"
SEPARATE, COMPOSED = "separate", "composed"  # the controller's nodes
FAST = "composed, 100 Hz"  # odometry; else it is at 30 Hz
END_TO_END = "end to end"  # latency from the sensor's message to the command
# late ticks, %, at most, by the share of a core; of separate and composed nodes the better ones
SHARES = {1.0: 0.0, 1 / 2: 0.0, 1 / 3: 1.0}
NODE_FIGURES = ("cpu_percent", "pss_mb")
PERCENTILES = ("p50", "p99", "max")  # of a latency
WALK_FIGURES = (
    "ticks",
    "deadline_misses",
    "unanswered",
    "missed_ticks",
    "real_time_factor",
    "mean_v_x",
    "fallback_cycles",
)

# Composed, as on the robot: a thirteenth of its 8 GB. A page that n processes share counts 1/n in
# each.
PSS_MB, CONTROLLER_PSS_MB = 600.0, 250.0
# Plausibility of the walk: the figures of a robot that fell do not count.
# m/s; rad, where a supervisor would stop the robot
LEAST_SPEED, LARGEST_TILT = (0.05, 0.5)
# What composition saves at the least, against separate processes in the same run.
# In lockstep robot and supervisor are in the process too.
LATENCY_RATIO, CPU_RATIO, LEAST_SPEEDUP = 0.8, 0.8, 1.7
# CPU of the controller with odometry at 100 Hz over that at 30 Hz: the ticks are as many.
FAST_CPU_RATIO = 1.4
# CPU of a replay, without start-up, over controller and plant
REPLAY_RATIO = 2.0
REPLAYED = 60.0  # s of a walk
# Goals for the robot, which are the machine's too.
CONTROLLER_CPU, RECORDER_CPU = 30.0, 5.0  # % of a core, at 30 Hz
# ms, of the policy: after the estimate, and in all
FEEDBACK_CPU, POLICY_CPU = (0.5, 4.0)
LOCKSTEP_SPEED = 8.0  # times real time, composed
REPLAY_CPU = 3.0  # s, of `REPLAYED`, without start-up
LARGEST_CYCLE = 3.0  # CPU of a cycle of the MPC's node, messages included, over its solution alone


@dataclass(frozen=True)
class Plan:
    """Repeats and durations of the benchmark."""

    repeats: int
    duration: float  # s of each walk in real time, after the warm-up
    lockstep: float  # s of graph time, after the warm-up
    blocks: int  # repeats of the closed loop
    endurance: float  # s of graph time of the long walk


QUICK, FULL = Plan(1, 10.0, 10.0, 5, 0.0), Plan(3, 60.0, 30.0, 20, 3600.0)


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Run the graph as `QUICK` or `FULL` plans; the plot goes to `out/graph.png`."""
    plan = QUICK if quick else FULL
    graph = read_graph()
    values = {argument.name: argument.default for argument in graph.arguments}
    progress("closed loop in one process")
    # compiles what the nodes load too
    rows = [closed_loop_row(values, plan.blocks)]
    progress("cycle of the MPC's node")
    rows.append(cycle_row(CYCLES))
    modes = {SEPARATE: values, COMPOSED: values | {"composed": True}}
    attempts = Attempts()
    for mode, chosen in modes.items():
        progress(name := f"lockstep, {mode}")
        if one := attempts.run(
            name,
            measure_walk,
            graph,
            chosen | {"lockstep": True},
            plan.lockstep,
        ):
            rows.append(
                {
                    "kind": "lockstep",
                    "nodes": mode,
                    "duration_s": one.metrics.duration,
                    "speed": one.metrics.real_time_factor,
                }
            )
    modes[FAST] = modes[COMPOSED] | {"scene": "fast_odometry"}
    walks: dict[str, list[Walk]] = {mode: [] for mode in modes}
    for repeat in range(plan.repeats):
        for mode, chosen in modes.items():
            progress(
                name := f"real time, {mode}, {repeat + 1} of {plan.repeats}"
            )
            if one := attempts.run(
                name, measure_walk, graph, chosen, plan.duration
            ):
                walks[mode].append(one)
    limited = list[Row]()
    for share, mode in product(SHARES, (SEPARATE, COMPOSED)):
        progress(name := f"real time, {mode}, {share:.2g} of a core each")
        if one := attempts.run(
            name, measure_walk, graph, modes[mode], plan.duration, share
        ):
            limited.append(share_row(mode, share, one))
    if walks[SEPARATE] and walks[COMPOSED]:
        draw(walks[SEPARATE], walks[COMPOSED], out / "graph.png")
    of_walks = [
        row
        for mode, some in walks.items()
        for repeat, one in enumerate(some)
        for row in walk_rows(mode, repeat, one)
    ]
    rows += [*of_walks, *medians(of_walks), *limited]
    if plan.endurance:
        progress(f"long walk in lockstep, {plan.endurance:g} s")
        rows += (
            attempts.run(
                "long walk", long_walk, graph, modes[COMPOSED], plan.endurance
            )
            or []
        )
    return [*rows, *attempts.rows], [
        *checks(rows, plan),
        *endurance_checks(rows),
        *attempts.checks,
    ]


def draw(walks: Sequence[Walk], composed: Sequence[Walk], path: Path) -> None:
    """Write the plot: share of ticks whose latency exceeds a time, by stage and from end to end."""
    curves = dict(
        zip(STAGES, np.concatenate([walk.ticks.latency for walk in walks]).T)
    )
    curves |= {END_TO_END: due(walks), f"{END_TO_END}, composed": due(composed)}
    figure = Figure(figsize=(8.5, 5.0), layout="constrained")
    ax = figure.subplots()
    draw_longer(ax, {name: 1e3 * values for name, values in curves.items()})
    period = 1e3 * walks[0].ticks.period
    ax.axvline(period, color=palette.INK, ls=":", lw=1)
    ax.text(period, 1.0, "control period ", va="top", ha="right", fontsize=8)
    ax.set(xlabel="latency, ms", title="Ticks that took longer than a time")
    figure.savefig(path, dpi=130)


def due(walks: Sequence[Walk]) -> Array:
    """Latencies from a sensor's message to the command, of all that were due, s."""
    ticks = [walk.ticks for walk in walks]
    return np.concatenate(
        [
            one.end_to_end[one.time[:, 0] + one.period <= one.end]
            for one in ticks
        ]
    )


def cycle_row(ticks: int) -> dict[str, Any]:
    """Time of the MPC node's cycle in the walk, serialized inputs to serialized output; no DDS.

    The preparation for the next cycle is timed apart.
    """
    loop, period = ClosedLoop("flat", "walk", None, 0), read_gaits().dt
    walking = [
        (
            messages.preview_to_msg(tick.preview),
            messages.state_to_msg(tick.estimate),
        )
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
    return {
        "kind": "cycle",
        "p99_ms": 1e3 * np.percentile(elapsed, 99),
        "median_ms": 1e3 * np.median(elapsed),
        "cpu_ms": 1e3 * np.median(cpu),
        "solve_cpu_ms": 1e3 * np.median(alone),
        "prepare_cpu_ms": 1e3 * np.median(preparing),
    }


def closed_loop_row(values: Mapping[str, Any], blocks: int) -> Row:
    """CPU time of controller and simulated robot in one process, per second of graph time."""
    ticks = ClosedLoop(
        values["scene"], values["gait"], None, values["seed"]
    ).run((blocks + 1) * BLOCK)  # the first one warms up
    used = cpu_time(lambda: deque(islice(ticks, BLOCK), maxlen=0), blocks)
    duration = BLOCK * read_gaits().dt
    return {
        "kind": "closed loop",
        "duration_s": blocks * duration,
        "cpu_s_per_s": used / duration,
        "speed": duration / used,
    }


def walk_rows(mode: str, repeat: int, one: Walk) -> list[Row]:
    """Rows of one walk: its metrics, every stage, every node."""
    which, m = {"nodes": mode, "repeat": repeat}, one.metrics
    walk = {
        "kind": "walk",
        **which,
        "duration_s": m.duration,
        "period_ms": 1e3 * m.period,
        **{name: getattr(m, name) for name in WALK_FIGURES},
        "tilt_max_rad": m.tilt_max,
        "replay_cpu_s_per_s": one.replay_cpu,
        "replay_differences": one.replay_differences,
    }
    latency = [
        {"kind": "latency", **which, "stage": stage}
        | {f"{p}_ms": 1e3 * getattr(found, p) for p in PERCENTILES}
        for stage, found in {**m.stages, END_TO_END: m.end_to_end}.items()
    ]
    figures = np.column_stack([one.cpu, one.pss])
    nodes = [*zip(one.nodes, figures), (ALL_NODES, figures.sum(axis=0))]
    return [
        walk,
        *latency,
        *(
            {"kind": "node", **which, "node": node}
            | dict(zip(NODE_FIGURES, some))
            for node, some in nodes
        ),
    ]


def share_row(mode: str, share: float, one: Walk) -> Row:
    """Row of a walk with a share of a core for each process; `slowest`: what breaks first."""
    m = one.metrics
    slowest = max(m.stages, key=lambda name: np.nan_to_num(m.stages[name].p99))
    return {
        "kind": "share",
        "nodes": mode,
        "share": share,
        "late_percent": 100.0 * m.deadline_misses / max(m.ticks, 1),
        "p50_ms": 1e3 * m.end_to_end.p50,
        "p99_ms": 1e3 * m.end_to_end.p99,
        "unanswered": m.unanswered,
        "fallback_cycles": m.fallback_cycles,
        "mean_v_x": m.mean_v_x,
        # stages of one process publish after the command
        "slowest": slowest if mode == SEPARATE else CONTROLLER,
    }


def medians(rows: Sequence[Row]) -> list[Row]:
    """One row for each kind, stage and node: the median of every number over the repeats."""
    groups: dict[tuple[str, ...], list[Row]] = defaultdict(list)
    for row in rows:
        groups[
            tuple(value for value in row.values() if isinstance(value, str))
        ].append(row)
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

    The last ten goals are for the robot, and depend on the speed of the machine. Latencies to the
    command are rows without a check; those to the servo have theirs in `servo`. CPU and speed of
    the graph beside one process have none either, as its kernels gain more by a quicker processor
    than messages do. Without the rows of a walk its checks are missed.
    """

    def figures(name: str, **which: Any) -> list[Any]:
        found = [
            r[name] for r in rows if which.items() <= r.items() and name in r
        ]
        return found or [math.nan]

    def median(name: str, mode: str, **which: Any) -> float:
        return figures(name, nodes=mode, repeat="median", **which)[0]

    stages = sum(median("cpu_percent", SEPARATE, node=node) for node in STAGES)
    controller = median("cpu_percent", COMPOSED, node=CONTROLLER)
    younger = median("p50_ms", COMPOSED, stage=END_TO_END)
    younger /= median("p50_ms", SEPARATE, stage=END_TO_END)
    [cycle] = (row for row in rows if row["kind"] == "cycle")
    solve, prepare = cycle["solve_cpu_ms"], cycle["prepare_cpu_ms"]
    [loop] = figures("cpu_s_per_s", kind="closed loop")
    memory, own = (
        max(figures("pss_mb", nodes=COMPOSED, node=node))
        for node in (ALL_NODES, CONTROLLER)
    )
    replay = median("replay_cpu_s_per_s", SEPARATE, kind="walk")
    fast = median("cpu_percent", FAST, node=CONTROLLER)
    recorder = median("cpu_percent", SEPARATE, node=RECORDER)
    beside = "composed over separate"
    fastest, slowest = (
        figures("speed", kind="lockstep", nodes=mode)[0]
        for mode in (COMPOSED, SEPARATE)
    )
    return [
        at_least(
            "shortest walk",
            min(figures("duration_s", kind="walk")),
            plan.duration,
            "s",
        ),
        at_least(
            "least mean v_x", min(figures("mean_v_x")), LEAST_SPEED, "m/s"
        ),
        at_most(
            "largest tilt", max(figures("tilt_max_rad")), LARGEST_TILT, "rad"
        ),
        at_most("memory of all nodes, composed", memory, PSS_MB, "MB"),
        at_most(
            "memory of the controller, composed", own, CONTROLLER_PSS_MB, "MB"
        ),
        at_most(
            "CPU of the MPC node over its solver",
            cycle["cpu_ms"] / solve,
            LARGEST_CYCLE,
        ),
        at_most(
            f"{beside}: odometry to command, median", younger, LATENCY_RATIO
        ),
        at_most(
            f"{beside}: CPU of the controller", controller / stages, CPU_RATIO
        ),
        at_least(f"{beside}: lockstep speed", fastest / slowest, LEAST_SPEEDUP),
        at_most(
            "CPU of a replay over controller and plant",
            replay / loop,
            REPLAY_RATIO,
        ),
        at_most(
            "stages that a replay changes",
            max(figures("replay_differences")),
            0,
        ),
        at_most(
            "100 Hz over 30 Hz: controller", fast / controller, FAST_CPU_RATIO
        ),
        at_most(
            "CPU of the policy's feedback phase", solve, FEEDBACK_CPU, "ms"
        ),
        at_most(
            "CPU of the policy in a tick", solve + prepare, POLICY_CPU, "ms"
        ),
        at_most(
            "CPU of the controller, composed", controller, CONTROLLER_CPU, "%"
        ),
        at_most("CPU of the recorder", recorder, RECORDER_CPU, "%"),
        at_most(
            "100 Hz: unanswered ticks",
            max(figures("unanswered", nodes=FAST)),
            0,
        ),
        at_least("lockstep speed, composed", fastest, LOCKSTEP_SPEED, "times"),
        *(
            at_most(
                f"late ticks with {share:.2g} of a core each, the better of both",
                min(
                    figures("late_percent", nodes=mode, share=share)[0]
                    for mode in (SEPARATE, COMPOSED)
                ),
                goal,
                "%",
            )
            for share, goal in SHARES.items()
        ),
        at_most("CPU of a replay of 60 s", REPLAYED * replay, REPLAY_CPU, "s"),
    ]
