"""Parameter file of `config/parameters`: values, their origin, residuals and uncertainty.

values              by dotted name, for `read_robot`
from, note          origin of the values
data                file of the measurements, its SHA-256 and number of measurements
residuals           per measurement: conditions, measured, predicted, sigma, difference over sigma
fit                 sum of squares, degrees of freedom, condition of the Jacobian, parameters at a
                    bound
confidence          95 % intervals, or `undetermined`: no influence, or wider than the bounds
correlation         of the fitted coordinates, in the order of confidence; null: undetermined
validity            least and largest value of each condition of the data
force_angle_line    theta_deg = (f_z + a) / b, of the samples and of the predictions at their angles
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml
from scipy.stats import t as student

from slot_core.arrays import Array
from slot_lab.calibration.data import Data
from slot_lab.calibration.fit import LEVEL, ParameterEstimate

HEAD = """# Parameter set of the robot; `parameters` in config/robot.yaml names the set in use.
# Written by scripts/calibrate; slot_lab/calibration/parameter_file.py describes the keys.
"""
DIGITS = 6  # significant, of values and predictions
WIDTH = 160  # characters a line; a measurement fits in one
UNDETERMINED = "undetermined"
RESULTS = ("kind", "measured", "predicted", "sigma", "off_by_sigma")


def record(  # noqa: PLR0917
    data: Data,
    names: Sequence[str],
    estimate: ParameterEstimate,
    values: Mapping[str, float],
    origin: str,
    note: str,
) -> dict[str, Any]:
    """Content of the file.

    names: the fitted parameters. values: of the whole set, by dotted name. origin, note:
    text.
    """
    return {
        "values": {name: float(value) for name, value in values.items()},
        "from": origin,
        **({"note": note} if note else {}),
        "data": {"file": data.name, "sha256": data.sha256, "figures": len(data.rows)},
        "residuals": residuals(data, estimate),
        "fit": {
            "sum_of_squares": rounded(estimate.chi_square),
            "degrees_of_freedom": estimate.freedom,
            "condition": rounded(estimate.condition),
            "at_limit": [n for n, at in zip(names, estimate.at_limit) if at],
        },
        "confidence": {n: interval_of(row) for n, row in zip(names, estimate.interval)},
        "correlation": correlation_of(estimate.correlation),
        "validity": data.validity(),
        "force_angle_line": lines(data, estimate.predicted),
    }


def residuals(data: Data, estimate: ParameterEstimate) -> list[dict[str, Any]]:
    """Conditions and residual of each measurement."""
    return [
        {
            "kind": row.kind,
            **row.conditions(),
            "measured": row.value,
            "predicted": rounded(predicted),
            "sigma": row.sigma,
            "off_by_sigma": rounded((predicted - row.value) / row.sigma, 3),
        }
        for row, predicted in zip(data.rows, estimate.predicted)
    ]


@dataclass(frozen=True)
class ForceLine:
    """Force-angle line f_z = b theta - a, the paper's theta = (f_z + a) / b.

    The half widths of the 95 % intervals are NaN for two samples.
    """

    a: float  # N
    b: float  # N/deg
    a_half_width: float  # N
    b_half_width: float  # N/deg
    residuals: Array  # (n,) N, line minus sample

    def content(self) -> dict[str, Any]:
        """The line in the file."""
        return {
            "a_N": rounded(self.a),
            "b_N_per_deg": rounded(self.b),
            "a_confidence": _about(self.a, self.a_half_width),
            "b_confidence": _about(self.b, self.b_half_width),
            "residuals_N": [round(float(value), DIGITS) for value in self.residuals],
        }


def fit_line(theta_deg: Array, force: Array, sigma: Array) -> ForceLine:
    """Fit the line to samples (n,): angle, deg, force and its sigma, N.

    Weighted linear regression; with the residual variance, the weighted sum of squares
    over n - 2, the intervals follow Student's distribution with n - 2 degrees of
    freedom. Raises ValueError unless two angles differ.
    """
    if np.ptp(theta_deg) == 0.0:
        raise ValueError("a line needs samples at two angles")
    freedom = len(force) - 2
    factor = student.ppf((1 + LEVEL) / 2, freedom) if freedom else math.nan
    scaling: Literal[True, "unscaled"] = True if freedom else "unscaled"
    line, covariance = np.polyfit(theta_deg, force, 1, w=1 / sigma, cov=scaling)
    b_half_width, a_half_width = (factor * np.sqrt(np.diag(covariance))).tolist()
    residuals = np.polyval(line, theta_deg) - force
    b, minus_a = line.tolist()
    return ForceLine(-minus_a, b, a_half_width, b_half_width, residuals)


def lines(data: Data, predicted: Array) -> list[dict[str, Any]]:
    """Force-angle lines of the samples and of the predictions (n,).

    One for each height and friction of force_angle samples at two angles or more.
    """
    groups: dict[tuple[float, float], list[int]] = {}
    for i, row in enumerate(data.rows):
        if row.kind == "force_angle":
            groups.setdefault((row.height_m, row.friction), []).append(i)
    out = []
    for (height, friction), members in groups.items():
        rows = [data.rows[i] for i in members]
        theta = np.array([row.theta_deg for row in rows])
        if np.ptp(theta) == 0.0:
            continue
        sigma = np.array([row.sigma for row in rows])
        measured = np.array([row.value for row in rows])
        out.append(
            {
                "height_m": height,
                "friction": friction,
                "theta_deg": [float(theta.min()), float(theta.max())],
                "measured": fit_line(theta, measured, sigma).content(),
                "predicted": fit_line(theta, predicted[members], sigma).content(),
            }
        )
    return out


def write(path: Path, content: Mapping[str, Any], head: str = HEAD) -> None:
    """Write the file and create its directory if necessary; raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    values = {"values": content["values"]}
    rest = {key: value for key, value in content.items() if key != "values"}
    body = yaml.safe_dump(rest, sort_keys=False, default_flow_style=None, width=WIDTH)
    path.write_text(head + yaml.safe_dump(values, sort_keys=False) + body)


def table(content: Mapping[str, Any]) -> list[str]:
    """Text of the content, line by line, for the terminal."""
    out = _residual_table(content["residuals"])
    fit = content["fit"]
    out += [
        f"sum of squares {fit['sum_of_squares']:.4g}, {fit['degrees_of_freedom']} degrees"
        f" of freedom, condition {fit['condition']:.3g}",
        "",
        f"{'parameter':<28}{'value':>12}   95 % interval",
    ]
    for name, interval in content["confidence"].items():
        value = content["values"][name]
        limit = "   at its bound" if name in fit["at_limit"] else ""
        out.append(f"{name:<28}{value:>12.6g}   {_bounds(interval)}{limit}")
    out += ["", "correlation"]
    for name, row in zip(content["confidence"], content["correlation"]):
        cells = ("     -" if v is None else f"{v:6.2f}" for v in row)
        out.append(f"{name:<28}" + "".join(cells))
    for line in content["force_angle_line"]:
        out += _line_table(line)
    return out


def _residual_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    conditions = [[f"{k} {row[k]:g}" for k in row if k not in RESULTS] for row in rows]
    labels = [" ".join([row["kind"], *texts]) for row, texts in zip(rows, conditions)]
    width = max(map(len, labels)) + 1
    head = f"{'measured':>11}{'predicted':>11}{'sigma':>9}{'off by':>8}"
    out = [f"{'measurement':<{width}}{head}"]
    for label, row in zip(labels, rows):
        out.append(
            f"{label:<{width}}{row['measured']:>11.5g}{row['predicted']:>11.5g}"
            f"{row['sigma']:>9.3g}{row['off_by_sigma']:>8.2f}"
        )
    return out


def _line_table(line: Mapping[str, Any]) -> list[str]:
    place = f"{line['height_m']:g} m, friction {line['friction']:g}"
    out = ["", f"theta_deg = (f_z + a) / b at {place}"]
    for which in ("measured", "predicted"):
        part = line[which]
        a = f"a {part['a_N']:.4g} N ({_bounds(part['a_confidence'])})"
        b = f"b {part['b_N_per_deg']:.4g} N/deg ({_bounds(part['b_confidence'])})"
        out.append(f"{which:<10} {a}, {b}")
    return out


def _bounds(interval: Sequence[float] | str) -> str:
    if isinstance(interval, str):
        return interval
    return f"{interval[0]:.4g} to {interval[1]:.4g}"


def rounded(value: float, digits: int = DIGITS) -> float:
    """A value with its significant digits of the file."""
    return float(f"{value:.{digits}g}")


def correlation_of(correlation: Array) -> list[list[float | None]]:
    """Rows of a correlation in the file; null for NaN."""
    rows = correlation.tolist()
    return [[rounded(v, 3) if math.isfinite(v) else None for v in r] for r in rows]


def interval_of(interval: Sequence[float] | Array) -> list[float] | str:
    """Ends of an interval with four digits; UNDETERMINED for NaN."""
    if any(math.isnan(value) for value in interval):
        return UNDETERMINED
    return [rounded(float(value), 4) for value in interval]


def _about(value: float, half_width: float) -> list[float] | str:
    return interval_of((value - half_width, value + half_width))
