"""Tables and plots of a validation: alignment, errors, and the paper's two tables."""

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.robot import LEG_POINTS, TORSO
from slot_lab.validation.comparison import (
    AXES,
    NAMES,
    Comparison,
    PointSeries,
    paper_points,
)

DPI = 100
# times the best shift's rest, up to which another shift is as good
RIVAL = 1.05
SHARES = ("nrmse", "error", "accuracy")  # metrics that are parts of one
TITLES = {
    "rmse": "RMSE",
    "mae": "MAE",
    "nrmse": "NRMSE",
    "mean_error": "avg error",
    "error": "error",
    "accuracy": "accuracy",
}


def report(comparison: Comparison, frame: str) -> list[str]:
    """All tables as text, line by line."""
    lines = [
        *alignment_lines(comparison, frame),
        "",
        *coordinate_table(comparison),
    ]
    for leg, points in paper_points(comparison).items():
        lines += ["", *leg_table(comparison, leg, points)]
    if (TORSO, "x") in comparison.series:
        # the paper's table of the whole body
        x, z = (
            _with_interval(comparison.series[TORSO, axis], axis, "rmse")
            for axis in "xz"
        )
        lines += [
            "",
            f"{'whole body':<14}{'RMSE in x':>26}{'RMSE in z':>26}",
            f"{'torso':<14}{x:>26}{z:>26}",
        ]
    return lines


def alignment_lines(comparison: Comparison, frame: str) -> list[str]:
    """Alignment in time and space, and its ambiguities."""
    time, placed = comparison.time, comparison.frame
    turned = np.degrees(Rotation.from_matrix(placed.rotation).as_rotvec())
    clock = (
        f"clock    first sample of the measurement at {time.offset:.4f} s of the run"
        f" (+- {1e3 * time.offset_width:.1f} ms), drift {1e6 * time.drift:.0f} ppm"
        f" (+- {1e6 * time.drift_width:.0f})"
    )
    lines = [clock.replace("+- nan", "+- ?")]
    if time.rival_rest < RIVAL * time.rest:
        lines.append(
            f"         {time.rival_offset:.3f} s is nearly as good"
            f" ({1e3 * time.rival_rest:.2f} mm of rest, here {1e3 * time.rest:.2f}):"
            " periodic motion; if that is right, give --offset"
        )
    lines.append(
        f"frame    {frame}: turn about x y z {_numbers(turned, 2)} deg, shift"
        f" {_numbers(1e3 * placed.shift, 1)} mm"
    )
    if comparison.only:
        lines.append(
            f"points   only in one recording: {', '.join(comparison.only)}"
        )
    if comparison.brief:
        lines.append(
            f"points   seen too briefly or too late: {', '.join(comparison.brief)}"
        )
    return lines


def coordinate_table(comparison: Comparison) -> list[str]:
    """Errors of every coordinate, with the interval of the RMSE."""
    head = "".join(f"{TITLES[name]:>11}" for name in NAMES)
    lines = [f"{'point':<16}{'axis':<6}{head}   95 % of the RMSE"]
    for (point, axis), series in comparison.series.items():
        low, high = (scale(axis) * v for v in series.errors.interval["rmse"])
        cells = "".join(f"{cell(series, axis, name):>11}" for name in NAMES)
        between = (
            "-" if math.isnan(low) else f"{low:.2f} to {high:.2f} {unit(axis)}"
        )
        lines.append(f"{point:<16}{axis:<6}{cells}   {between}")
    return lines


def leg_table(
    comparison: Comparison, leg: str, points: dict[str, str]
) -> list[str]:
    """The paper's table of the single leg: z of four points, with 95 % intervals."""
    columns = ("fixed base", "1/3 length", "2/3 length", "tip")
    title = f"single leg {leg}".rstrip() + ", z"
    lines = [title + "".join(f"{c:>26}" for c in columns)]
    for name in NAMES:
        series = [comparison.series[points[p], "z"] for p in LEG_POINTS]
        cells = (f"{_with_interval(each, 'z', name):>26}" for each in series)
        lines.append(TITLES[name].ljust(len(title)) + "".join(cells))
    return lines


def write_csv(comparison: Comparison, path: Path) -> None:
    """Write all errors with their intervals as CSV, m or rad and parts of one; raises OSError."""
    with path.open("w", newline="") as stream:
        out = csv.writer(stream)
        ends = [f"{name}_{end}" for name in NAMES for end in ("low", "high")]
        out.writerow(["point", "axis", "samples", "range", *NAMES, *ends])
        for (point, axis), series in comparison.series.items():
            e = series.errors
            bounds = [bound for name in NAMES for bound in e.interval[name]]
            numbers = [e.span, *(e.value[name] for name in NAMES), *bounds]
            out.writerow(
                [point, axis, e.samples, *(f"{v:.6g}" for v in numbers)]
            )


def scale(axis: str) -> float:
    """Factor from SI to the unit of the tables."""
    return 1e3 if axis in AXES else 180.0 / math.pi


def unit(axis: str) -> str:
    """Unit of the tables."""
    return "mm" if axis in AXES else "deg"


def cell(series: PointSeries, axis: str, name: str) -> str:
    """A metric with its unit."""
    value = _factor(axis, name) * series.errors.value[name]
    if name not in SHARES:
        return f"{value:.2f} {unit(axis)}"
    return "-" if math.isnan(value) else f"{value:.2f} %"


def _with_interval(series: PointSeries, axis: str, name: str) -> str:
    low, high = (_factor(axis, name) * v for v in series.errors.interval[name])
    shown = cell(series, axis, name)
    return shown if math.isnan(low) else f"{shown} ({low:.2f}, {high:.2f})"


def _factor(axis: str, name: str) -> float:
    return 100.0 if name in SHARES else scale(axis)


def _numbers(values: Array | Sequence[float], digits: int) -> str:
    return " ".join(
        f"{round(float(v), digits) + 0.0:.{digits}f}" for v in values
    )


def draw(comparison: Comparison, title: str, out: Path) -> list[Path]:
    """Write `torso.png`, and `leg.png` or `FL_leg.png` for each leg; raises OSError."""
    figures = {"torso": [key for key in comparison.series if key[0] == TORSO]}
    for leg, points in paper_points(comparison).items():
        figures[f"leg {leg}".rstrip()] = [
            (points[name], "z") for name in LEG_POINTS
        ]
    return [
        _figure(
            comparison,
            keys,
            f"{title}: {what}",
            out / f"{'_'.join(reversed(what.split()))}.png",
        )
        for what, keys in figures.items()
        if keys
    ]


def _figure(
    comparison: Comparison,
    keys: Sequence[tuple[str, str]],
    title: str,
    path: Path,
) -> Path:
    figure = Figure(
        figsize=(11.0, 1.9 * len(keys) + 0.8), dpi=DPI, layout="constrained"
    )
    figure.suptitle(title, fontsize=12, fontweight="bold")
    axes = figure.subplots(
        len(keys), 2, sharex=True, squeeze=False, width_ratios=(1.6, 1.0)
    )
    for (both, difference), (point, axis) in zip(axes, keys):
        found, factor = comparison.series[point, axis], scale(axis)
        run, measured = factor * found.run, factor * found.measured
        both.plot(
            found.t, measured, ".", ms=2.5, color=palette.INK, label="measured"
        )
        both.plot(found.t, run, color=palette.SECONDARY, lw=1.2, label="run")
        both.set_title(f"{point} {axis} ({unit(axis)})", fontsize=9, loc="left")
        difference.plot(found.t, run - measured, color=palette.TRUE, lw=0.8)
        difference.axhline(0.0, color=palette.INK, lw=0.6)
        rmse = f"RMSE {factor * found.errors.value['rmse']:.2f} {unit(axis)}"
        difference.set_title(f"run - measured, {rmse}", fontsize=9, loc="left")
    for ax in axes.flat:
        ax.tick_params(labelsize=8)
        ax.grid(color=palette.SHADE)
    axes[0][0].legend(fontsize=8, frameon=False, ncols=2)
    for ax in axes[-1]:
        ax.set_xlabel("time of the run (s)", fontsize=9)
    figure.savefig(path, dpi=DPI)
    return path
