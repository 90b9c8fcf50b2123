"""Plots of a walk: the dashboard, a function for each of its panels."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, FigureBase
from matplotlib.ticker import FuncFormatter

from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.geometry import rotate
from slot_core.robot import LEGS
from slot_core.safety.states import State
from slot_lab.bags.bag import Bag, NoFieldError
from slot_lab.bags.recorded_walk import (
    STAGES,
    Ticks,
    TorsoTrack,
    joint_columns,
    read_motion,
    read_ticks,
    seconds,
    stride_mean,
    stride_period,
)
from slot_lab.bags.topics import PLANS
from slot_lab.desk_command import write_plot
from slot_lab.report.constraint_map import draw_slack, read_map
from slot_lab.report.metrics import WalkMetrics
from slot_lab.report.traces import PLOTS, disturbances

# inches, dots per inch: legible at the width of a page
SIZE, SHARP = ((11.5, 9.2), 140)
WIDTHS = (1.0, 1.0, 1.2)  # of its columns, relative
WINDOW = 4.0  # s at the end of the walk, shown in the panels of the legs
LATENCY_BINS = 60
TITLE_PAD = 12.0  # points, above the legend
LEGEND: dict[str, Any] = {
    "fontsize": 7,
    "bbox_to_anchor": (1.0, 0.97),
    "borderpad": 0.0,
    "borderaxespad": 0.2,
    "columnspacing": 1.2,
    "handlelength": 1.5,
    "frameon": False,
    "loc": "lower right",
    "ncols": 3,
}
STATE_COLOURS = {
    State.WALKING: "#cfe3f1",
    State.STANDING: "#d6ebe4",
    State.HOLD: "#f8e3bd",
    State.RELAX: "#f5cdb8",
    State.ESTOP: "#f5cdb8",
    State.FAULT: "#f5cdb8",
}


def dashboard(bag: Bag, metrics: WalkMetrics, path: Path) -> None:
    """Write the dashboard of a walk as a PNG of 1610 x 1288 pixels; raises BagError."""
    write_plot(dashboard_figure(bag, metrics), path, SHARP)


def dashboard_figure(bag: Bag, metrics: WalkMetrics) -> Figure:
    """The dashboard; the label of each axes is the name of its panel."""
    figure = Figure(figsize=SIZE, dpi=SHARP, layout="constrained")
    figure.suptitle(bag.path.name, fontsize=14, fontweight="bold")
    left, middle, right = cast(
        Any, figure.subfigures(1, 3, wspace=0.03, width_ratios=WIDTHS)
    )
    motion = read_motion(bag)
    path, state, height, speed, tilt = _stack(
        left,
        ["path", "state", "height", "speed", "tilt"],
        (1.3, 0.12, 1.0, 1.0, 1.0),
    )
    draw_path(path, motion, motion.between(motion.t[0] + metrics.warm_up))
    draw_states(state, bag, motion.t[0], motion.t[-1])
    height.plot(
        motion.t - motion.t[0],
        1e3 * motion.position[:, 2],
        color=palette.TRUE,
        lw=1,
    )
    _over_time(height, motion, metrics.warm_up, "height of base_link", "z (mm)")
    draw_speed(speed, motion, stride_period(bag), metrics.warm_up)
    draw_tilt(tilt, motion, metrics.warm_up)

    names = [f"{kind} {leg}" for kind in ("angle", "force") for leg in LEGS]
    axes = _stack(middle, names, (1.0,) * len(names))
    draw_angles(axes[:4], bag, motion.t[0], motion.t[-1])
    draw_forces(axes[4:], bag, motion.t[0], motion.t[-1])

    latency, slack, disturbance = _stack(
        right, ["latency", "slack", "disturbance"], (1.0, 1.6, 1.0)
    )
    draw_latency(latency, read_ticks(bag).after(motion.t[0] + metrics.warm_up))
    draw_constraints(slack, bag, motion.t[0])
    draw_disturbance(disturbance, bag, motion.t[0])
    return figure


def _stack(
    figure: FigureBase, names: Sequence[str], heights: Sequence[float]
) -> list[Axes]:
    grid = figure.add_gridspec(len(names), 1, height_ratios=heights)
    return [
        figure.add_subplot(grid[i], label=name) for i, name in enumerate(names)
    ]


def draw_path(ax: Axes, motion: TorsoTrack, counted: TorsoTrack) -> None:
    """Top view of the torso's path, and the straight line from which drift is measured.

    `counted` is the motion after the warm-up. The line starts there, along the heading at
    the start of the bag, and is as long as the way along it. A circle marks the start, a
    triangle the end.
    """
    start, heading = counted.position[0, :2], motion.rpy[0, 2]
    along = rotate(counted.position[:, :2] - start, -heading)[:, 0].max()
    end = start + rotate(np.array([along, 0.0]), heading)
    ax.plot(
        *motion.position[:, :2].T, color=palette.TRUE, lw=1.6, label="torso"
    )
    ax.plot(
        *np.array([start, end]).T,
        color=palette.INK,
        lw=1,
        ls="--",
        label="initial heading",
    )
    ax.plot(*motion.position[0, :2], "o", color=palette.TRUE, ms=6)
    ax.plot(*motion.position[-1, :2], ">", color=palette.SECONDARY, ms=8)
    ax.set_aspect("equal", adjustable="datalim")
    _finish(ax, f"path, top view ({motion.source})", "y (m)", "x (m)")
    ax.legend(**LEGEND)


def draw_states(ax: Axes, bag: Bag, start: float, end: float) -> None:
    """States of the supervisor from graph time `start` to `end` (s), as coloured spans.

    A state has its name if it lasts for 8 % of the time.
    """
    if bag.counts.get("/robot_state"):
        series = bag.series("/robot_state", "state")
        time, states = (
            seconds(series.stamp) - start,
            series["state"].astype(int),
        )
        begins = np.flatnonzero(np.diff(states, prepend=-1))
        for begin, last in zip(begins, [*time[begins[1:]], end - start]):
            # it reports before it moves
            state, first = (State(states[begin]), max(time[begin], 0.0))
            ax.axvspan(
                first, last, color=STATE_COLOURS.get(state, palette.SHADE)
            )
            if last - first > 0.08 * (end - start):
                ax.text(
                    (first + last) / 2,
                    0.5,
                    state.name,
                    fontsize=7,
                    ha="center",
                    va="center",
                )
    ax.set(xlim=(0.0, end - start), ylim=(0.0, 1.0), xticks=[], yticks=[])
    ax.spines[:].set_visible(False)


def draw_speed(
    ax: Axes, motion: TorsoTrack, period: float | None, warm_up: float
) -> None:
    """Forward velocity along the heading, raw and averaged over the stride around each time."""
    v_x = motion.heading_velocity[:, 0]
    t = motion.t - motion.t[0]
    ax.plot(t, v_x, color=palette.PALE, lw=0.8, label="momentary")
    if period is not None:
        ax.plot(
            t,
            stride_mean(t, v_x, period),
            color=palette.SECONDARY,
            lw=1.8,
            label=f"mean over a stride, {period:.2f} s",
        )
    ax.axhline(0.0, color=palette.INK, lw=0.6)
    _over_time(ax, motion, warm_up, "forward velocity", "v_x (m/s)")
    ax.legend(**LEGEND)


def draw_tilt(ax: Axes, motion: TorsoTrack, warm_up: float) -> None:
    """Roll and pitch."""
    for name, colour, angle in zip(
        ("roll", "pitch"), (palette.TRUE, palette.SECONDARY), motion.rpy.T
    ):
        ax.plot(
            motion.t - motion.t[0],
            np.degrees(angle),
            color=colour,
            lw=1,
            label=name,
        )
    _over_time(ax, motion, warm_up, "roll and pitch", "angle (deg)")
    ax.set_xlabel("time (s)")
    ax.legend(**LEGEND)


def draw_angles(
    axes: Sequence[Axes], bag: Bag, start: float, end: float
) -> None:
    """Tendon angles of each leg, desired and measured, over the last WINDOW seconds."""
    for topic, label in (
        ("/desired_joint_angles", "desired"),
        ("/joint_states", "measured"),
    ):
        if bag.counts.get(topic):
            t, angle = joint_columns(bag, topic, "position")
            _per_leg(axes, t - start, np.degrees(angle), label)
    _finish_legs(axes, "tendon angles (deg)", end - start)


def draw_forces(
    axes: Sequence[Axes], bag: Bag, start: float, end: float
) -> None:
    """Normal forces of each leg, planned and true, over the last WINDOW seconds.

    The planned ones are of the plan's first stage; only a simulator publishes true ones.
    """
    for topic, field, label in (
        ("/tendon_plan", "force", "planned"),
        ("/ground_truth/legs", "ground_force", "true"),
    ):
        if bag.counts.get(topic):
            series = bag.series(topic, field)
            first = series[field].reshape(len(series), -1, len(LEGS), 3)[:, 0]
            _per_leg(axes, seconds(series.stamp) - start, first[..., 2], label)
    _finish_legs(axes, "normal forces (N)", end - start)
    axes[-1].set_xlabel("time (s)")


def draw_latency(ax: Axes, ticks: Ticks) -> None:
    """Histogram of every stage's latency and of the whole chain's.

    Both axes are logarithmic: a single late tick stays visible beside thousands. Latencies
    that are not positive, of nodes in one process, are left out.
    """
    columns = [*ticks.latency.T, ticks.end_to_end]
    ms = [
        1e3 * column[np.isfinite(column) & (column > 0)] for column in columns
    ]
    if measured := [values for values in ms if len(values)]:
        low = min(v.min() for v in measured)
        high = max(1e3 * ticks.period, *(v.max() for v in measured))
        bins = np.geomspace(low / 1.2, high * 1.2, LATENCY_BINS).tolist()
        for values, name, colour in zip(
            ms,
            (*STAGES, "end to end"),
            (*palette.STAGE_COLOURS, palette.INK),
        ):
            ax.hist(
                values,
                bins,
                histtype="stepfilled",
                color=colour,
                alpha=0.75,
                label=name,
            )
        ax.set(xscale="log", yscale="log")  # a single late tick stays visible
    ax.axvline(
        1e3 * ticks.period,
        color=palette.INK,
        ls="--",
        lw=1,
        label="control period",
    )
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    _finish(ax, "", "ticks", "latency (ms, logarithmic)")
    ax.legend(**LEGEND | {"ncols": 2})


def draw_disturbance(ax: Axes, bag: Bag, start: float) -> None:
    """Disturbances that the policy estimates: payload, slip and turning.

    The panel stays empty for a bag whose plans have none.
    """
    if bag.counts.get("/tendon_plan"):
        with suppress(NoFieldError):  # a bag from before there was an observer
            series = bag.series("/tendon_plan", "wrench", "drift")
            found = disturbances(series["wrench"].T, series["drift"].T)
            curve, time = (
                PLOTS["disturbance"].curves["mpc"],
                seconds(series.stamp) - start,
            )
            for values, name, colour in zip(found, curve.names, curve.colours):
                ax.plot(time, values, color=colour, lw=1, label=name)
            ax.legend(**LEGEND | {"ncols": 2})
    _finish(ax, "", "disturbance", "time (s)")


def draw_constraints(ax: Axes, bag: Bag, start: float) -> None:
    """Dynamic Constraint Map: slack of each constraint of the plan's first stage over time."""
    if bag.counts.get(PLANS, 0) > 1:
        found = read_map(bag).active
        bar = draw_slack(
            ax, replace(found, time=found.time + found.begin - start)
        )
        bar.ax.tick_params(labelsize=7)
        bar.ax.yaxis.label.set_fontsize(8)
    _finish(ax, "Dynamic Constraint Map", "", "time (s)")
    ax.tick_params(axis="y", labelsize=7)
    ax.grid(visible=False)


def _per_leg(axes: Sequence[Axes], t: Array, values: Array, label: str) -> None:
    style: dict[str, Any] = {"color": palette.INK, "ls": "--", "lw": 1}
    for ax, leg, column in zip(axes, LEGS, values.T):
        if label in ("true", "measured"):
            style = {
                "color": palette.LEG_COLOURS[leg],
                "lw": 1.8,
                "alpha": 0.75,
            }
        ax.plot(t, column, label=label, **style)


def _finish_legs(axes: Sequence[Axes], title: str, end: float) -> None:
    for ax, leg in zip(axes, LEGS):
        _finish(ax, "", leg, "")
        ax.set_xlim(max(0.0, end - WINDOW), end)
        ax.tick_params(labelbottom=ax is axes[-1])
    axes[0].set_title(title, fontsize=9, loc="left", pad=TITLE_PAD)
    if axes[0].lines:
        axes[0].legend(**LEGEND)


def _over_time(
    ax: Axes, motion: TorsoTrack, warm_up: float, title: str, label: str
) -> None:
    ax.axvspan(0.0, warm_up, color=palette.SHADE, zorder=0)
    ax.set_xlim(0.0, motion.t[-1] - motion.t[0])
    _finish(ax, title, label, "")


def _finish(ax: Axes, title: str, y_label: str, x_label: str) -> None:
    ax.set_title(title, fontsize=9, loc="left", pad=TITLE_PAD)
    ax.set_ylabel(y_label, fontsize=8)
    ax.set_xlabel(x_label, fontsize=8)
    ax.tick_params(labelsize=7)
    ax.grid(color="#e3e7eb", lw=0.6)
    ax.set_axisbelow(True)
    ax.spines[["top", "right"]].set_visible(False)
