"""The Dynamic Constraint Map of a bag: slack of every constraint of the plan over time.

Read from `/tendon_plan`, first stage of every cycle: for each leg the slack of the least and the
largest normal force, of friction, of the tendon angle and of its rate; for the whole robot the
slack of the total support and of the balance of the normal forces. Cycles without a solution are
hatched. Fields that the messages of an older bag lack are listed and left out.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colorbar import Colorbar
from matplotlib.colors import LinearSegmentedColormap, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.clock import to_seconds
from slot_core.command_line import ProgressLine
from slot_core.control.policy import Status
from slot_core.drawing import palette
from slot_core.robot import LEGS
from slot_lab.bags.bag import Bag, BagError, NoFieldError
from slot_lab.bags.recorded_walk import seconds
from slot_lab.bags.topics import PLANS
from slot_lab.desk_command import Outcome, write_plot

PER_LEG = {
    "slack_normal_min": "least normal",
    "slack_normal_max": "largest normal",
    "slack_friction": "friction",
    "slack_angle": "angle",
    "slack_rate": "rate",
}
# of constraints whose slack is no force in N
UNITS = {"angle": "rad", "rate": "rad/s"}
OF_THE_ROBOT = {
    "slack_total": "total support",
    "slack_balance": "total balance",
}
# in the unit of a slack: the violation that is a solver's rounding
TOLERANCE = 1e-4
COLOURS = LinearSegmentedColormap.from_list(
    "slack",
    [
        (0.0, "#67000d"),
        (0.4999, "#ef3b2c"),
        (0.5001, "#f7fbff"),
        (1.0, palette.TRUE),
    ],
)
"""Red where a constraint is violated, pale blue where it is met with zero slack."""
HATCHED: dict[str, Any] = {
    "facecolor": "none",
    "edgecolor": palette.INK,
    "hatch": "////",
}
# columns of the plot; of more cycles each shows its least slack
CAPACITY = 1600


@dataclass(frozen=True)
class ConstraintMap:
    """Slack over n cycles; NaN where a constraint is inactive."""

    name: str  # of the bag
    begin: float  # s of graph time, of the first cycle
    time: Array  # (n,) s since the first cycle
    constraints: tuple[str, ...]
    slack: Array  # (constraints, n) in `unit`, negative is violated
    status: NDArray[np.uint8]  # (n,) values of `Status`
    missing: tuple[str, ...]  # fields that the bag's messages lack

    @property
    def violated(self) -> NDArray[np.bool_]:
        """(constraints, n), true where violated by more than the solver's tolerance."""
        return self.slack < -TOLERANCE

    @property
    def active(self) -> ConstraintMap:
        """The map without the constraints that the policy does not have."""
        rows = np.flatnonzero(np.isfinite(self.slack).any(axis=1))
        return replace(
            self,
            constraints=tuple(self.constraints[row] for row in rows),
            slack=self.slack[rows],
        )


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Draw the map of a bag; exit code 1 if a constraint is violated.

    Raises BagError, OSError.
    """
    progress("reading the bag")
    found = read_map(Bag(options.bag, options.namespace))
    bag = options.bag.resolve()
    # a directory v0.05 has no suffix
    stem = bag.name if bag.is_dir() else bag.stem
    out = options.out or bag.with_name(f"{stem}_constraints.png")
    write_plot(map_figure(found), out, dpi=110)
    return [*summary_lines(found), str(out)], int(found.violated.any())


def read_map(bag: Bag) -> ConstraintMap:
    """The map of a bag; raises BagError if it holds no forces or none of the slacks."""
    if not bag.counts.get(PLANS):
        raise BagError(f"{bag.path}: {PLANS} holds no messages")
    names: list[str] = []
    rows: list[Array] = []
    missing: list[str] = []
    for field, label in (PER_LEG | OF_THE_ROBOT).items():
        try:
            column = bag.series(PLANS, field)[field]
        except NoFieldError:
            missing.append(field)
            continue
        names += (
            [f"{leg} {label}" for leg in LEGS] if field in PER_LEG else [label]
        )
        rows.append(column.reshape(len(column), -1).T)
    if not rows:
        raise BagError(
            f"{bag.path}: {PLANS} has none of the fields {', '.join(missing)}"
        )
    series = bag.series(PLANS, "status")
    begin = int(series.stamp[0])
    slack = np.concatenate(rows).astype(float)
    return ConstraintMap(
        name=bag.path.name,
        begin=to_seconds(begin),
        time=seconds(series.stamp, begin),
        constraints=tuple(names),
        slack=np.where(np.isfinite(slack), slack, np.nan),  # infinite: inactive
        status=series["status"],
        missing=tuple(missing),
    )


def unit(constraint: str) -> str:
    """Unit of the slack of a constraint."""
    return UNITS.get(constraint.rpartition(" ")[2], "N")


def summary_lines(found: ConstraintMap) -> list[str]:
    """Cycles by status, and for each constraint its least slack, when, and how often violated."""
    counts = {
        status.name: int((found.status == status).sum()) for status in Status
    }
    lines = [
        f"{found.name}: {len(found.time)} cycles over {found.time[-1]:.2f} s",
        "  ".join(f"{name} {count}" for name, count in counts.items() if count),
        f"{'constraint':<18}{'least slack':>12}{'at':>14}{'violated':>10}",
    ]
    for name, slack, violated in zip(
        found.constraints, found.slack, found.violated
    ):
        if np.isnan(slack).all():
            lines.append(f"{name:<18}{'inactive':>22}")
            continue
        at = int(np.nanargmin(slack))
        lines.append(
            f"{name:<18}{slack[at]:10.4f} {unit(name):<5}{found.time[at]:8.2f} s"
            f"{int(violated.sum()):10d}"
        )
    return lines + [
        f"{field}: not in the messages of this bag" for field in found.missing
    ]


def map_figure(found: ConstraintMap) -> Figure:
    """Heat map: constraints down, time across; cycles without a solution are hatched."""
    shown = found.active
    height = 1.2 + 0.36 * len(shown.constraints)
    figure = Figure(figsize=(14, height), layout="constrained")
    ax = figure.subplots()
    draw_slack(ax, shown)
    bad, edges = shown.status != Status.SOLVED, _edges(shown.time)
    steps = np.diff(bad.astype(int), prepend=0, append=0)
    for begin, end in np.flatnonzero(steps).reshape(-1, 2):
        ax.axvspan(edges[begin], edges[end], lw=0.8, **HATCHED)
    ax.tick_params(axis="y", labelsize=8)
    ax.set(xlabel="time (s)")
    violated = int(shown.violated.any(axis=0).sum())
    ax.set_title(
        f"Dynamic Constraint Map, {shown.name}: {len(shown.time)} cycles, "
        f"{violated} with a violation, {int(bad.sum())} not solved",
        loc="left",
        fontsize=10,
    )
    ax.legend(
        handles=[
            Patch(label="not solved", **HATCHED),
            Patch(
                facecolor=palette.SHADE, edgecolor=palette.INK, label="inactive"
            ),
        ],
        ncols=2,
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        fontsize=8,
        frameon=False,
    )
    return figure


def draw_slack(ax: Axes, found: ConstraintMap) -> Colorbar:
    """The slacks as colours, with a line between the kinds of constraint; returns the colour bar.

    Every kind is scaled by its legs' largest slack: the total support is larger, and would leave
    the legs pale.
    """
    time = found.time  # starts of the cycles; the last one ends a period later
    edges = _edges(time)
    groups = np.arange(0, len(time), -(-len(time) // CAPACITY))
    # NaN only where all are
    rows = np.fmin.reduceat(found.slack, groups, axis=1)
    rows[(rows < 0) & (rows >= -TOLERANCE)] = 0.0
    units = np.array([unit(name) for name in found.constraints])
    of_legs = np.array(
        [name not in OF_THE_ROBOT.values() for name in found.constraints]
    )
    for kind in set(units):
        same = units == kind
        rows[same] /= np.nanmax(np.abs(rows[same & of_legs]), initial=TOLERANCE)
    mesh = ax.pcolormesh(
        np.append(edges[groups], edges[-1]),
        np.arange(len(rows) + 1),
        rows,
        cmap=COLOURS,
        norm=TwoSlopeNorm(0.0, -1.0, 1.0),
        rasterized=True,
    )
    bar = ax.figure.colorbar(
        mesh,
        ax=ax,
        label="slack over the largest\nof its kind, red: violated",
        pad=0.01,
        extend="both",
    )
    ax.set_yticks(np.arange(len(rows)) + 0.5, found.constraints)
    ax.invert_yaxis()
    for row in range(len(LEGS), len(rows), len(LEGS)):
        ax.axhline(row, color=palette.INK, lw=0.8)
    ax.set_facecolor(palette.SHADE)  # shows where a constraint is inactive
    return bar


def _edges(time: Array) -> Array:
    """Begins of the cycles and the end of the last one, s."""
    period = float(np.median(np.diff(time))) if len(time) > 1 else 1.0
    return np.append(time, time[-1] + period)
