"""The plot of the graph's benchmark: latency of each stage, CPU and memory of each node."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from benchmarks.graph.measured_walk import Walk
from benchmarks.harness import machine
from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_lab.bags.recorded_walk import STAGES, Ticks

END_TO_END = "end to end"


def draw(walks: Sequence[Walk], composed: Sequence[Walk], path: Path) -> None:
    """Write the plot of all repeats with separate nodes; of composed ones the latency."""
    figure = Figure(figsize=(13.0, 5.0), dpi=100, layout="constrained")
    duration = walks[0].metrics.duration
    waiting = np.median([one.waited for one in walks])
    figure.suptitle(
        f"graph in real time, {len(walks)} x {duration:.0f} s, {machine()['cores']} cores of "
        f"{machine()['cpu']}, on which any program waited for a core {waiting:.0f} % of the time",
        fontsize=11,
        fontweight="bold",
    )
    latency, cpu = figure.subplots(1, 2, width_ratios=(1.3, 1.0))
    draw_latency(latency, [one.ticks for one in walks], [one.ticks for one in composed])
    draw_cpu(cpu, walks)
    figure.savefig(path)


def draw_latency(ax: Axes, ticks: Sequence[Ticks], composed: Sequence[Ticks]) -> None:
    """Share of ticks whose latency exceeds a time, per stage; shows every late tick.

    A tick without a command has infinite latency, so the curve `end to end` may end above zero.
    """
    stages = np.concatenate([one.latency for one in ticks])
    curves = [(stage, len(stage), name) for stage, name in zip(stages.T, STAGES)]
    curves += [
        (*whole(ticks), END_TO_END),
        (*whole(composed), f"{END_TO_END}, composed"),
    ]
    colours = (*palette.STAGE_COLOURS, palette.INK, palette.INK)
    for (values, count, name), colour in zip(curves, colours):
        ms = 1e3 * np.sort(values[np.isfinite(values)])
        later = 1 - np.arange(len(ms)) / count
        dashes = "--" if "composed" in name else "-"
        ax.step(ms, later, dashes, where="pre", color=colour, lw=1.8, label=name)
    for share, name in ((0.5, "p50"), (0.01, "p99")):
        ax.axhline(share, color=palette.PALE, lw=1, zorder=0)
        ax.annotate(
            name,
            (1, share),
            (2, 0),
            xycoords=("axes fraction", "data"),
            textcoords="offset points",
            va="center",
            fontsize=7,
        )
    period = 1e3 * ticks[0].period
    ax.axvline(
        period,
        color=palette.INK,
        ls=":",
        lw=1,
        label=f"control period, {period:.0f} ms",
    )
    ax.set(xscale="log", yscale="log")
    ax.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ax.xaxis.set_minor_formatter(NullFormatter())
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    title = "latency of each stage"
    finish(ax, title, "latency (ms, logarithmic)", "share of ticks that took longer")
    ax.legend(fontsize=8, frameon=False, loc="lower left")


def whole(ticks: Sequence[Ticks]) -> tuple[Array, int]:
    """Latencies from odometry to command, s, and the number of commands that were due."""
    due = [one.end_to_end[one.time[:, 0] + one.period <= one.end] for one in ticks]
    return np.concatenate(due), sum(map(len, due))


def draw_cpu(ax: Axes, walks: Sequence[Walk]) -> None:
    """CPU of each node (bar: median, dots: repeats), labelled with its proportional memory."""
    nodes = walks[0].usage.nodes
    cpu = np.array([one.cpu for one in walks])
    pss = np.median([one.usage.pss for one in walks], axis=0) / 1e6
    known = dict(zip(STAGES, palette.STAGE_COLOURS))
    colours = [known.get(node, palette.TORSO) for node in nodes]
    bars = ax.barh(nodes, np.median(cpu, axis=0), color=colours, height=0.65)
    for bar, values, mb in zip(bars, cpu.T, pss):
        y = bar.get_y() + bar.get_height() / 2
        ax.plot(values, np.full(len(values), y), "o", color=palette.INK, ms=3)
        ax.annotate(
            f"{mb:.0f} MB",
            (values.max(), y),
            (6, 0),
            textcoords="offset points",
            va="center",
            fontsize=8,
        )
    ax.margins(x=0.15)
    ax.invert_yaxis()
    finish(ax, "CPU and memory of each node", "CPU (% of one core)", "")


def finish(ax: Axes, title: str, x_label: str, y_label: str) -> None:
    """Title, labels and grid, as in the panels of the dashboard."""
    ax.set_title(title, fontsize=10, loc="left")
    ax.set_xlabel(x_label, fontsize=9)
    ax.set_ylabel(y_label, fontsize=9)
    ax.tick_params(labelsize=8)
    ax.grid(color="#e3e7eb", lw=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
