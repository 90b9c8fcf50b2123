"""Tables of a validation: alignment, errors of every coordinate, and the paper's two tables."""

from __future__ import annotations

import csv
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array
from slot_core.robot import LEG_POINTS, TORSO
from slot_lab.validation.comparison import AXES, Comparison, PointSeries, paper_points
from slot_lab.validation.error_metrics import NAMES

RIVAL = 1.05  # times the best shift's rest, up to which another shift is as good
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
    lines = [*alignment_lines(comparison, frame), "", *coordinate_table(comparison)]
    for leg, points in paper_points(comparison).items():
        lines += ["", *leg_table(comparison, leg, points)]
    if (TORSO, "x") in comparison.series:
        lines += ["", *torso_table(comparison)]
    return lines


def alignment_lines(comparison: Comparison, frame: str) -> list[str]:
    """Alignment in time and space, and its ambiguities."""
    time, placed = comparison.time, comparison.frame
    turned = np.degrees(Rotation.from_matrix(placed.rotation).as_rotvec())
    lines = [
        f"clock    first sample of the measurement at {time.offset:.4f} s of the run"
        f" (+- {_width(1e3 * time.offset_width, 1)} ms), drift {1e6 * time.drift:.0f} ppm"
        f" (+- {_width(1e6 * time.drift_width, 0)})",
        f"frame    {frame}: turn about x y z {_numbers(turned, 2)} deg, shift"
        f" {_numbers(1e3 * placed.shift, 1)} mm",
    ]
    if time.rival_rest < RIVAL * time.rest:
        rests = f"{1e3 * time.rival_rest:.2f} mm of rest, here {1e3 * time.rest:.2f}"
        lines.insert(
            1,
            f"         {time.rival_offset:.3f} s is nearly as good ({rests}): periodic motion; if"
            " that is right, give --offset",
        )
    if comparison.only:
        lines.append(f"points   only in one recording: {', '.join(comparison.only)}")
    if comparison.brief:
        lines.append(
            f"points   seen too briefly or too late: {', '.join(comparison.brief)}"
        )
    return lines


def _width(value: float, digits: int) -> str:
    return "?" if math.isnan(value) else f"{value:.{digits}f}"


def coordinate_table(comparison: Comparison) -> list[str]:
    """Errors of every coordinate, with the interval of the RMSE."""
    head = "".join(f"{TITLES[name]:>11}" for name in NAMES)
    lines = [f"{'point':<16}{'axis':<6}{head}   95 % of the RMSE"]
    for (point, axis), series in comparison.series.items():
        low, high = (scale(axis) * v for v in series.errors.interval["rmse"])
        cells = "".join(f"{cell(series, axis, name):>11}" for name in NAMES)
        between = "-" if math.isnan(low) else f"{low:.2f} to {high:.2f} {unit(axis)}"
        lines.append(f"{point:<16}{axis:<6}{cells}   {between}")
    return lines


def leg_table(comparison: Comparison, leg: str, points: dict[str, str]) -> list[str]:
    """The paper's table of the single leg: z of four points, with 95 % intervals."""
    columns = ("fixed base", "1/3 length", "2/3 length", "tip")
    lines = [
        f"single leg {leg}".rstrip() + ", z" + "".join(f"{c:>26}" for c in columns)
    ]
    width = len(lines[0]) - 26 * len(columns)
    for name in NAMES:
        cells = [
            _with_interval(comparison.series[points[p], "z"], "z", name)
            for p in LEG_POINTS
        ]
        lines.append(TITLES[name].ljust(width) + "".join(f"{c:>26}" for c in cells))
    return lines


def torso_table(comparison: Comparison) -> list[str]:
    """The paper's table of the whole body: RMSE of x and z of the torso."""
    cells = [
        _with_interval(comparison.series[TORSO, axis], axis, "rmse")
        for axis in ("x", "z")
    ]
    return [
        f"{'whole body':<14}{'RMSE in x':>26}{'RMSE in z':>26}",
        f"{'torso':<14}" + "".join(f"{c:>26}" for c in cells),
    ]


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
            out.writerow([point, axis, e.samples, *(f"{v:.6g}" for v in numbers)])


def scale(axis: str) -> float:
    """Factor from SI to the unit of the tables."""
    return 1e3 if axis in AXES else 180.0 / math.pi


def unit(axis: str) -> str:
    """Unit of the tables."""
    return "mm" if axis in AXES else "deg"


def cell(series: PointSeries, axis: str, name: str) -> str:
    """A metric with its unit."""
    value = series.errors.value[name]
    if name in ("nrmse", "error", "accuracy"):
        return "-" if math.isnan(value) else f"{100 * value:.2f} %"
    return f"{scale(axis) * value:.2f} {unit(axis)}"


def _with_interval(series: PointSeries, axis: str, name: str) -> str:
    factor = 100.0 if name in ("nrmse", "error", "accuracy") else scale(axis)
    low, high = (factor * v for v in series.errors.interval[name])
    if math.isnan(low):
        return cell(series, axis, name)
    return f"{cell(series, axis, name)} ({low:.2f}, {high:.2f})"


def _numbers(values: Array | Sequence[float], digits: int) -> str:
    return " ".join(f"{round(float(v), digits) + 0.0:.{digits}f}" for v in values)
