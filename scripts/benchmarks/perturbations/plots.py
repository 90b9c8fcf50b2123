"""The plots of the perturbations: costs or motion over time, and the failed samples."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.perturbations.cases import (
    CASES,
    DURATION,
    HEIGHT,
    HEIGHT_BAND,
    SETTLED,
    TABLE,
    TILT_BAND,
    PerturbedRun,
    runs_of,
)
from benchmarks.perturbations.samples import LIMITS, RANGES, interval
from slot_core.drawing import palette
from slot_core.robot import Array

Row = Mapping[str, Any]

STUDIES = {
    "published": "(a) as published, on its own linear model",
    "torso": "(b) policy forces, rigid torso with 50 ms of lag",
    "robot": "(c) default policy, Cosserat robot, standing",
}
COSTS = ("published", "torso")  # of the MPC; the default policy's cost has other terms
COLOURS = dict(zip(CASES, (palette.INK, palette.TRUE, *palette.STAGE_COLOURS, palette.TORSO)))
STYLES = {"Roll": "--", "Velocity": "-.", "Noise": ":"}
LEAST_COST = 1e-6
SHOWN = {"torso": 3.0, "robot": 2.0}  # s
BINS = 6
LIMIT_COLOURS = (palette.SECONDARY, "#CC79A7", "#E69F00", "#56B4E9", "#009E73", palette.INK, "k")
PAIRS = (("payload", "friction"), ("push", "friction"), ("lag", "noise"))


def draw_courses(courses: Mapping[str, Any], path: Path) -> None:
    """Draw the runs of stored courses."""
    draw_responses(runs_of(courses), path)


def draw_responses(runs: Mapping[str, Mapping[str, PerturbedRun]], path: Path) -> None:
    """Costs of the MPC over time in (a) and (b); height and tilt in (c); shaded: settled."""
    figure = Figure(figsize=(8, 8), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(2.2, 1, 1))
    for column, study in enumerate(COSTS):
        ax = figure.add_subplot(grid[0, column], label=study)
        _draw_lines(ax, runs[study], lambda run: np.maximum(run.cost, LEAST_COST))
        ax.set(yscale="log", ylim=(LEAST_COST, None), xlim=(0.0, SHOWN.get(study, DURATION)))
        ax.set(xlabel="time (s)", ylabel="cost of the MPC")
        ax.axhspan(LEAST_COST, SETTLED, color=palette.SHADE, zorder=0)
        ax.set_title(STUDIES[study], fontsize=9, loc="left")
    height = figure.add_subplot(grid[1, :], label="height")
    _draw_lines(height, runs["robot"], lambda run: 1e3 * (run.height - HEIGHT))
    height.axhspan(-1e3 * HEIGHT_BAND, 1e3 * HEIGHT_BAND, color=palette.SHADE, zorder=0)
    height.set(ylabel="height less 40 mm (mm)", xticklabels=[], xlim=(0.0, SHOWN["robot"]))
    height.set_title(STUDIES["robot"], fontsize=9, loc="left")
    leaning = figure.add_subplot(grid[2, :], label="tilt")
    _draw_lines(leaning, runs["robot"], lambda run: np.degrees(run.tilt))
    leaning.axhspan(0.0, math.degrees(TILT_BAND), color=palette.SHADE, zorder=0)
    leaning.set(
        ylabel="tilt (deg)", xlabel="time (s)", xlim=(0.0, SHOWN["robot"]), ylim=(0.0, None)
    )
    handles, names = height.get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=len(names), frameon=False,
                  fontsize=8)  # fmt: skip
    figure.savefig(path, dpi=130)


def _draw_lines(
    ax: Axes, runs: Mapping[str, PerturbedRun], value: Callable[[PerturbedRun], Array]
) -> None:
    for name, run in runs.items():
        style = {"color": COLOURS[name], "ls": STYLES.get(name, "-"), "lw": 1.3}
        ax.plot(run.time, value(run), label=name, **style)
    ax.grid(color=palette.PALE, lw=0.4)


def table_lines(rows: Sequence[Row]) -> list[str]:
    """Cases down, the paper and the three studies across."""
    found = {(row["study"], row["case"]): row for row in rows if row["kind"] == "case"}
    head = f"{'':<10}{'paper':^34}|" + "|".join(f"{study:^50}" for study in COSTS) + "| robot"
    names = f"{'':<10}{'max':>8}{'mean':>8}{'final':>8}{'settled':>10}|"
    costs = f"{'max':>9}{'mean':>8}{'final':>8}{'cost s':>9}"
    still = f"{'still s':>9}{'inf.':>6} "
    names += "|".join([costs + still, costs + still, still])
    lines = [head, names]
    for case, (most, mean, final, settled) in TABLE.items():
        line = f"{case:<10}{most:8.4f}{mean:8.4f}{final:8.4f}{_time(settled):>10}|"
        cells = [_cells(found[study, case]) for study in STUDIES if (study, case) in found]
        lines.append(line + "|".join(cells))
    return lines


def _cells(row: Row) -> str:
    cost = (
        f"{row['max_cost']:9.4f}{row['mean_cost']:8.4f}{row['final_cost']:8.4f}"
        f"{_time(row['settling_cost_s']):>9}"
    )
    still = f"{_time(row['settling_s']):>9}{row['infeasible']:>6} "
    return cost + still if row["study"] in COSTS else still


def _time(seconds: float) -> str:
    return f"{seconds:.3f}" if np.isfinite(seconds) else "-"


def draw_failures(rows: Sequence[Row], title: str, path: Path) -> None:
    """Rate of failure over each parameter, and the failures in three planes of two parameters."""
    figure = Figure(figsize=(14, 7.5), layout="constrained")
    grid = figure.add_gridspec(2, 1)
    top = grid[0].subgridspec(1, len(RANGES))
    below = grid[1].subgridspec(1, len(PAIRS))
    for column, name in enumerate(RANGES):
        draw_rate(figure.add_subplot(top[column], label=name), rows, name)
    for column, (x, y) in enumerate(PAIRS):
        draw_plane(figure.add_subplot(below[column], label=f"{x} {y}"), rows, x, y)
    figure.axes[0].set_ylabel("rate of failure, 95 % interval")
    figure.axes[len(RANGES)].legend(fontsize=8, loc="upper right")
    figure.suptitle(title)
    figure.savefig(path, dpi=110)


def draw_rate(ax: Axes, rows: Sequence[Row], name: str) -> None:
    """Rate of failure in `BINS` equal parts of a parameter's range."""
    edges = np.linspace(*RANGES[name], BINS + 1)
    place = np.digitize([row[name] for row in rows], edges[1:-1])
    failed = np.array([bool(row["failed"]) for row in rows])
    for k in range(BINS):
        count, bad = int((place == k).sum()), int(failed[place == k].sum())
        if count:
            low, high = interval(bad, count)
            middle = (edges[k] + edges[k + 1]) / 2
            ax.plot([middle, middle], [low, high], color=palette.TRUE, lw=2)
            ax.plot(middle, bad / count, "o", color=palette.TRUE)
    ax.set(xlim=RANGES[name], ylim=(-0.03, 1.03), xlabel=LABELS[name])
    ax.grid(color="#e3e7eb", lw=0.6)


def draw_plane(ax: Axes, rows: Sequence[Row], x: str, y: str) -> None:
    """Every sample in a plane of two parameters, coloured by the first limit it exceeds."""
    fine = [row for row in rows if not row["failed"]]
    ax.scatter([r[x] for r in fine], [r[y] for r in fine], 12, color=palette.PALE, label="recovers")
    for limit, colour in zip(LIMITS, LIMIT_COLOURS):
        bad = [(row[x], row[y]) for row in rows if row["failed"].split("+")[0] == limit]
        if bad:
            ax.scatter(*zip(*bad), 18, color=colour, marker="x", label=f"{limit} first")
    ax.set(xlim=RANGES[x], ylim=RANGES[y], xlabel=LABELS[x], ylabel=LABELS[y])


LABELS = {
    "payload": "payload (kg)",
    "friction": "friction",
    "lag": "lag (s)",
    "push": "push for 0.2 s (N)",
    "direction": "direction of the push (rad)",
    "noise": "noise over the sensors' own",
}
