"""Parameter file of `config/parameters`: values, their origin, residuals and uncertainty.

values              by dotted name, for `read_robot`
from, note          origin of the values
data                file of the measurements, its SHA-256 and number of measurements
residuals           per measurement: conditions, measured, predicted, sigma, difference over sigma
fit                 sum of squares, degrees of freedom, condition of the Jacobian, parameters at a
                    bound
confidence          95 % intervals, or `undetermined`: no influence, or wider than the bounds
correlation         of the fitted coordinates, in the order of confidence; null: undetermined
"""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from slot_core.arrays import Array
from slot_lab.calibration.data import Data
from slot_lab.calibration.fit import ParameterEstimate

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
        "data": {
            "file": data.name,
            "sha256": data.sha256,
            "figures": len(data.rows),
        },
        "residuals": residuals(data, estimate),
        "fit": {
            "sum_of_squares": rounded(estimate.chi_square),
            "degrees_of_freedom": estimate.freedom,
            "condition": rounded(estimate.condition),
            "at_limit": [n for n, at in zip(names, estimate.at_limit) if at],
        },
        "confidence": {
            n: interval_of(row) for n, row in zip(names, estimate.interval)
        },
        "correlation": correlation_of(estimate.correlation),
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


def write(path: Path, content: Mapping[str, Any], head: str = HEAD) -> None:
    """Write the file and create its directory if necessary; raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    rest = dict(content)
    values = yaml.safe_dump({"values": rest.pop("values")}, sort_keys=False)
    body = yaml.safe_dump(
        rest, sort_keys=False, default_flow_style=None, width=WIDTH
    )
    path.write_text(head + values + body)


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
        bounds = (
            interval
            if interval == UNDETERMINED
            else f"{interval[0]:.4g} to {interval[1]:.4g}"
        )
        limit = "   at its bound" if name in fit["at_limit"] else ""
        value = content["values"][name]
        out.append(f"{name:<28}{value:>12.6g}   {bounds}{limit}")
    out += ["", "correlation"]
    for name, row in zip(content["confidence"], content["correlation"]):
        out.append(
            f"{name:<28}"
            + "".join("     -" if v is None else f"{v:6.2f}" for v in row)
        )
    return out


def _residual_table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    labels = [
        " ".join(
            [row["kind"], *(f"{k} {row[k]:g}" for k in row if k not in RESULTS)]
        )
        for row in rows
    ]
    width = max(map(len, labels)) + 1
    head = f"{'measured':>11}{'predicted':>11}{'sigma':>9}{'off by':>8}"
    out = [f"{'measurement':<{width}}{head}"]
    for label, row in zip(labels, rows):
        out.append(
            f"{label:<{width}}{row['measured']:>11.5g}{row['predicted']:>11.5g}"
            f"{row['sigma']:>9.3g}{row['off_by_sigma']:>8.2f}"
        )
    return out


def rounded(value: float, digits: int = DIGITS) -> float:
    """A value with its significant digits of the file."""
    return float(f"{value:.{digits}g}")


def correlation_of(correlation: Array) -> list[list[float | None]]:
    """Rows of a correlation in the file; null for NaN."""
    return [
        [rounded(v, 3) if math.isfinite(v) else None for v in row]
        for row in correlation.tolist()
    ]


def interval_of(interval: Sequence[float] | Array) -> list[float] | str:
    """Ends of an interval with four digits; UNDETERMINED for NaN."""
    ends = [rounded(float(value), 4) for value in interval]
    return UNDETERMINED if any(map(math.isnan, ends)) else ends
