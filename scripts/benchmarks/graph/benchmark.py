"""Latency, CPU and memory of all nodes as separate processes in real time, and the speed without.

The graph walks in real time with its bag; once in lockstep; and once without ROS in one process,
as a reference for what the algorithms take. Percentages of CPU are of one core. The warm-up of
`config/record.yaml` is left out of every figure.
"""

import math
import statistics
import tempfile
import threading
import time
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import psutil
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter
from rclpy.serialization import deserialize_message, serialize_message

from benchmarks.harness import BenchmarkError, Check, Row, at_least, at_most, cpu_time, machine
from slot_bringup.graph import Graph, read_graph
from slot_bringup.monitor import RunError, watch
from slot_bringup.run import started
from slot_core.bags import decode
from slot_core.bags.bag import Bag, BagError, read_record_settings
from slot_core.bags.walk import STAGES, Ticks, read_motion, read_ticks
from slot_core.control.mpc.mpc import Mpc, read_mpc
from slot_core.control.pace import Pace
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.report import palette
from slot_core.report.metrics import Latency, WalkMetrics, walk_metrics
from slot_core.robot import Array, read_robot
from slot_core.simulation.closed_loop import ClosedLoop
from slot_msgs.msg import GaitPreview, MpcState
from slot_nodes import messages

STANDING = 1.0  # s, at most, from the first state to the first command: the robot is frozen
SAMPLE_PERIOD = 0.25  # s between looks at the processes; the kernel counts CPU time in 10 ms
BLOCK = 30  # ticks of the closed loop per repeat, about a second
CYCLE, CYCLES, CYCLE_MS = 0.033, 120, 2.0  # s between cycles, how many, goal of their median
END_TO_END = "end to end"
WHOLE = "all nodes"
NODE_FIGURES = ("cpu_percent", "rss_mb", "pss_mb")

# A command later than its period meets the next odometry: the controller then acts on old news.
# Half of the period in 99 of 100 ticks leaves the rest to a robot's processor half as fast.
PERIOD_SHARE_P99 = 0.5
# The nodes of one graph shall fit on one core, so that none waits for another on the robot's six.
CPU_PERCENT = 100.0
# A tenth of the robot's 8 GB, of memory where a page that n nodes share counts 1/n in each.
PSS_MB = 800.0
# Of real time: the simulated clock is the wall clock, so more than jitter is simulation lost.
REAL_TIME_ERROR = 0.01
# Figures of a robot that fell would be those of another task.
LEAST_SPEED, LARGEST_TILT = 0.05, 0.5  # m/s; rad, where a supervisor would stop the robot
# Lockstep is for tests: not worth its name below real time. One process has no messages to pay,
# and the plant alone is asked to take a tenth of real time; as much again is left for the control.
LOCKSTEP_SPEED, LOOP_CPU = 1.0, 0.2


@dataclass(frozen=True)
class Plan:
    """How much is run."""

    repeats: int
    duration: float  # s of each walk in real time, after the warm-up
    lockstep: float  # s of graph time, after the warm-up
    blocks: int  # of the closed loop


QUICK, FULL = Plan(1, 15.0, 10.0, 5), Plan(3, 60.0, 30.0, 20)


@dataclass
class Usage:
    """What the processes had used by each of n moments."""

    nodes: tuple[str, ...]
    time: list[float] = field(default_factory=list)  # (n,) s, wall clock
    cpu: list[list[float]] = field(default_factory=list)  # (n, nodes + 1) s; last: `waited`
    rss: list[float] = field(default_factory=list)  # (nodes,) bytes resident, at the end
    pss: list[float] = field(default_factory=list)  # (nodes,) of it proportional, at the end

    def percent(self, begin: float, end: float) -> Array:
        """(nodes + 1,) CPU of one core, and time waited, in percent between two wall times."""
        begin, end = max(begin, self.time[0]), min(end, self.time[-1])
        cpu = np.array(self.cpu).T
        used = [np.diff(np.interp([begin, end], self.time, column))[0] for column in cpu]
        return 100 * np.array(used) / (end - begin)


@dataclass(frozen=True)
class Walk:
    """One run of the graph and what it took."""

    metrics: WalkMetrics
    ticks: Ticks  # after the warm-up
    cpu: Array  # (nodes,) percent of one core
    waited: float  # percent of the time in which some program of the machine waited for a core
    usage: Usage


def run(quick: bool, out: Path, progress: Callable[[str], None]) -> tuple[list[Row], list[Check]]:
    """Run the graph as `Plan` says; the picture goes to `out/graph.png`."""
    plan = QUICK if quick else FULL
    graph = read_graph()
    values = {argument.name: argument.default for argument in graph.arguments}
    progress("closed loop in one process")
    loop = closed_loop_row(values, plan.blocks)  # compiles what the nodes will load, too
    progress("cycle of the MPC's node")
    cycle = cycle_row(CYCLES)
    progress("lockstep")
    lockstep = walk(graph, values | {"lockstep": True}, plan.lockstep)
    walks = []
    for repeat in range(plan.repeats):
        progress(f"real time, {repeat + 1} of {plan.repeats}")
        walks.append(walk(graph, values, plan.duration))
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


def walk(graph: Graph, values: Mapping[str, Any], duration: float) -> Walk:
    """Run the graph for `duration` (s) after the warm-up; raises BenchmarkError when it fails."""
    warm_up = read_record_settings().warm_up
    with tempfile.TemporaryDirectory() as scratch:
        directory = Path(scratch, "bag")
        try:
            usage = record(graph, {**values, "bag": str(directory)}, STANDING + warm_up + duration)
            bag = Bag(directory)
            metrics = walk_metrics(bag, warm_up, read_servo().stall_torque)
            ticks = read_ticks(bag).after(read_motion(bag).t[0] + warm_up)
        except (RunError, BagError, psutil.Error) as error:
            raise BenchmarkError(f"the graph did not walk: {error}") from error
        begin, end = bag.end_ns / 1e9 - ticks.end + ticks.time[[0, -1], 0]
    *cpu, waiting = usage.percent(begin, end)
    return Walk(metrics, ticks, np.array(cpu), waiting, usage)


def record(graph: Graph, values: Mapping[str, Any], duration: float) -> Usage:
    """Run the graph until its clock has gone on by `duration` (s); raises RunError."""
    names = [spec.name for spec in graph.nodes(values)]
    with tempfile.TemporaryDirectory() as logs, started(graph, values, Path(logs)) as processes:
        pids = {name: processes.pid(name) for name in names}
        with metered(pids) as usage:
            watch(processes, duration)
        add_memory(usage, pids.values())
        return usage


def cycle_row(ticks: int) -> dict[str, Any]:
    """What the MPC's node does between two messages and one, paced at 30 Hz without DDS."""
    loop = ClosedLoop("flat", "walk", None, 0)
    walk = [
        (messages.preview_to_msg(tick.preview), messages.state_to_msg(tick.estimate))
        for tick in loop.run(ticks)
    ]
    inputs = [tuple(map(serialize_message, pair)) for pair in walk]
    mpc, elapsed, cpu = Mpc(read_robot(), read_mpc(), time.perf_counter), [], []
    for preview, state in inputs:
        time.sleep(CYCLE)
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


@contextmanager
def metered(pids: Mapping[str, int]) -> Iterator[Usage]:
    """Sample the processes in the background while the block runs."""
    processes = [psutil.Process(pid) for pid in pids.values()]
    usage, ended = Usage(tuple(pids)), threading.Event()

    def sample() -> None:
        try:
            add_sample(usage, processes)
            while not ended.wait(SAMPLE_PERIOD):
                add_sample(usage, processes)
        except psutil.Error:
            pass  # a node has ended: whoever watches the processes names it

    thread = threading.Thread(target=sample, daemon=True)
    thread.start()
    try:
        yield usage
    finally:
        ended.set()
        thread.join()


def add_sample(usage: Usage, processes: Sequence[psutil.Process]) -> None:
    """Look once at every process and at the machine; raises psutil.Error when one is gone."""
    cpu = [sum(process.cpu_times()[:2]) for process in processes]
    usage.time.append(time.time())
    usage.cpu.append([*cpu, waited()])


def waited() -> float:
    """Time, s, in which some program waited for a core; NaN where the kernel does not count it."""
    try:
        counted = Path("/proc/pressure/cpu").read_text()
    except OSError:
        return math.nan
    return int(counted.partition("total=")[2].split()[0]) / 1e6


def add_memory(usage: Usage, pids: Iterable[int]) -> None:
    """Look once at the memory: to count shared pages takes the kernel too long for a sample."""
    for pid in pids:
        memory = psutil.Process(pid).memory_full_info()
        usage.rss.append(float(memory.rss))
        usage.pss.append(float(memory.pss))


def closed_loop_row(values: Mapping[str, Any], blocks: int) -> Row:
    """CPU time of controller and plant in one process per time walked, the median of blocks."""
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
    """Rows of one walk: itself, every stage, every node."""
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
    """A latency's figures in ms."""
    figures = {"p50_ms": latency.p50, "p99_ms": latency.p99, "max_ms": latency.max}
    return {name: 1e3 * value for name, value in figures.items()}


def medians(rows: Sequence[Row]) -> list[Row]:
    """The rows of all repeats as one: the median of every number."""
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
    """What is expected of a graph that keeps up: latency by the median, the rest by the worst."""

    def column(name: str, **which: Any) -> list[Any]:
        return [r[name] for r in rows if which.items() <= r.items() and name in r]

    def worst(name: str, kind: str = "walk", **which: Any) -> list[Any]:
        return [v for k in range(plan.repeats) for v in column(name, kind=kind, repeat=k, **which)]

    [p99] = column("p99_ms", stage=END_TO_END, repeat="median")
    [cpu] = column("cpu_percent", node=WHOLE, repeat="median")
    error = max(abs(factor - 1) for factor in worst("real_time_factor"))
    return [
        at_most("end to end p99", p99, 1e3 * PERIOD_SHARE_P99 * period, "ms"),
        at_most("deadline misses", sum(worst("deadline_misses")), 0, "ticks"),
        at_most("never answered", sum(worst("unanswered")), 0, "ticks"),
        at_most("missing odometries", sum(worst("missed_ticks")), 0, "ticks"),
        at_most("real-time factor off 1", 100 * error, 100 * REAL_TIME_ERROR, "%"),
        at_least("shortest walk", min(worst("duration_s")), plan.duration, "s"),
        at_least("least mean v_x", min(worst("mean_v_x")), LEAST_SPEED, "m/s"),
        at_most("largest tilt", max(worst("tilt_max_rad")), LARGEST_TILT, "rad"),
        at_most("CPU of all nodes", cpu, CPU_PERCENT, "% of one core"),
        at_most("memory of all nodes", max(worst("pss_mb", "node", node=WHOLE)), PSS_MB, "MB"),
        at_most("cycle of the MPC's node", column("median_ms", kind="cycle")[0], CYCLE_MS, "ms"),
        at_most(
            "its CPU at 200 Hz", 20.0 * column("cpu_ms", kind="cycle")[0], 100.0, "% of a core"
        ),
        at_least("lockstep speed", column("speed", kind="lockstep")[0], LOCKSTEP_SPEED, "x"),
        at_most("closed loop CPU", column("cpu_s_per_s")[0], LOOP_CPU, "s per s"),
    ]


def draw(walks: Sequence[Walk], path: Path) -> None:
    """Write the picture of all repeats."""
    figure = Figure(figsize=(13.0, 5.0), dpi=100, layout="constrained")
    FigureCanvasAgg(figure)
    duration = walks[0].metrics.duration
    waiting = np.median([one.waited for one in walks])
    figure.suptitle(
        f"graph in real time, {len(walks)} x {duration:.0f} s, {machine()['cores']} cores of "
        f"{machine()['cpu']}, on which some program waited for a core {waiting:.0f} % of the time",
        fontsize=11, fontweight="bold",
    )  # fmt: skip
    latency, cpu = figure.subplots(1, 2, width_ratios=(1.3, 1.0))
    draw_latency(latency, [one.ticks for one in walks])
    draw_cpu(cpu, walks)
    figure.savefig(path)


def draw_latency(ax: Axes, ticks: Sequence[Ticks]) -> None:
    """Share of ticks that took longer, per stage: every late tick is seen.

    A tick that was never answered took longer than any time, so the last curve may end high.
    """
    stages = np.concatenate([one.latency for one in ticks])
    due = [one.time[:, 0] + one.period <= one.end for one in ticks]
    whole = np.concatenate([one.end_to_end[judged] for one, judged in zip(ticks, due)])
    colours = (*palette.STAGE_COLOURS, palette.INK)
    for values, name, colour in zip([*stages.T, whole], (*STAGES, END_TO_END), colours):
        ms = 1e3 * np.sort(values[np.isfinite(values)])
        count = len(values) if name == END_TO_END else len(ms)
        later = 1 - np.arange(len(ms)) / count
        ax.step(ms, later, where="pre", color=colour, lw=1.8, label=name)
    for share, name in ((0.5, "p50"), (0.01, "p99")):
        ax.axhline(share, color=palette.PALE, lw=1, zorder=0)
        ax.annotate(name, (1, share), (2, 0), xycoords=("axes fraction", "data"),
                    textcoords="offset points", va="center", fontsize=7)  # fmt: skip
    period = 1e3 * ticks[0].period
    ax.axvline(period, color=palette.INK, ls="--", lw=1, label=f"control period, {period:.0f} ms")
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.xaxis.set_minor_formatter(NullFormatter())
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    finish(
        ax, "latency of each stage", "latency (ms, logarithmic)", "share of ticks that took longer"
    )
    ax.legend(fontsize=8, frameon=False, loc="lower left")


def draw_cpu(ax: Axes, walks: Sequence[Walk]) -> None:
    """CPU of each node, the median as a bar, every repeat as a dot; its proportional memory."""
    nodes = walks[0].usage.nodes
    cpu = np.array([one.cpu for one in walks])
    pss = np.median([one.usage.pss for one in walks], axis=0) / 1e6
    known = dict(zip(STAGES, palette.STAGE_COLOURS))
    colours = [known.get(node, palette.TORSO) for node in nodes]
    bars = ax.barh(nodes, np.median(cpu, axis=0), color=colours, height=0.65)
    for bar, values, mb in zip(bars, cpu.T, pss):
        y = bar.get_y() + bar.get_height() / 2
        ax.plot(values, np.full(len(values), y), "o", color=palette.INK, ms=3)
        ax.annotate(f"{mb:.0f} MB", (values.max(), y), (6, 0), textcoords="offset points",
                    va="center", fontsize=8)  # fmt: skip
    ax.margins(x=0.15)
    ax.invert_yaxis()
    finish(ax, "CPU and memory of each node", "CPU (% of one core)", "")


def finish(ax: Axes, title: str, x_label: str, y_label: str) -> None:
    """The look of the dashboard's panels."""
    ax.set_title(title, fontsize=10, loc="left")
    ax.set_xlabel(x_label, fontsize=9)
    ax.set_ylabel(y_label, fontsize=9)
    ax.tick_params(labelsize=8)
    ax.grid(color="#e3e7eb", lw=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
