"""Parameter set of a fit of the twin, as a file of `config/parameters`.

Beside the keys of slot_lab/calibration/parameter_file.py:

robot, scene, servo  values by dotted name instead of those of robot.yaml, of the scene that names
                     the set, and of servo.yaml
data                 recording, its topics or columns, strides of the fit and strides held out
errors               RMS of predicted minus measured, before and after, of both
confidence           95 % intervals by place; strides are taken as independent of each other
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from slot_core import config
from slot_core.config import ConfigError
from slot_core.refusal import quoted
from slot_core.robot import read_parameters
from slot_lab.calibration import parameter_file
from slot_lab.calibration.fit import ParameterEstimate
from slot_lab.twin.prediction import ModelParts
from slot_lab.twin.recorded import BagRecording
from slot_lab.twin.strides import StrideErrors
from slot_lab.twin.twin_fit import TwinFit, changes

HEAD = """# Parameter set of the robot; `parameters` of a scene, or in config/robot.yaml, names it.
# Written by scripts/twin; slot_lab/twin/parameter_set.py describes the keys.
"""
CORRELATED = 0.95  # beyond it the data determine a combination, not the parameters
UNITS = {
    "displacement": ("displacement of a stride", 1e3, "mm"),
    "place": ("place after 4 strides", 1e3, "mm"),
    "turn": ("turn of a stride", 180.0 / math.pi, "deg"),
    "height": ("mean height of a stride", 1e3, "mm"),
    "tilt": ("mean tilt of a stride", 180.0 / math.pi, "deg"),
}


def record(
    recorded: BagRecording, parts: ModelParts, start: str, found: TwinFit, note: str
) -> dict[str, Any]:
    """Content of the file; start: the set that the fit started from."""
    fitted = [parameter_file.rounded(value) for value in found.estimate.values]
    values, given = dict(read_parameters(start)), changes(parts, found.names, fitted)
    beside = {k: v for k, v in given["robot"].items() if k not in values}
    values |= {k: v for k, v in given["robot"].items() if k in values}
    kept = {part: read_parameters(start, part) for part in ("robot", "scene", "servo")}
    own = {"robot": beside, "scene": given["scene"], "servo": given["servo"]}
    result = found.estimate
    return {
        "values": values,
        **{part: kept[part] | own[part] for part in own if kept[part] | own[part]},
        "from": f"fit of the twin from {start}"
        + ("" if found.converged else ", not converged"),
        **({"note": note} if note else {}),
        "data": {
            "recording": recorded.name,
            "angles": recorded.angles.source,
            "motion": recorded.motion.source,
            "strides_of_fit": len(found.seen[0].level),
            "strides_held_out": len(found.held_out[0].level),
        },
        "errors": {
            name: {"before": _errors(pair[0]), "after": _errors(pair[1])}
            for name, pair in (("fit", found.seen), ("held_out", found.held_out))
        },
        "confidence": {
            n: parameter_file.interval_of(row)
            for n, row in zip(found.names, result.interval)
        },
        "correlation": [[_number(v) for v in row] for row in result.correlation],
    }


def write(name: str, content: dict[str, Any]) -> Path:
    """Write a new set of `config/parameters`; raises ConfigError if there is one of that name."""
    path = place_of(name)
    parameter_file.write(path, content, HEAD)
    return path.resolve()


def place_of(name: str) -> Path:
    """Path of a new set; raises ConfigError if the name is taken or is no name of a file."""
    path = config.config_dir() / "parameters" / f"{name}.yaml"
    if not name or not name.replace("_", "").replace("-", "").isalnum():
        raise ConfigError(f"--set {quoted(name)}: expected letters, digits, _ and -")
    if path.exists():
        raise ConfigError(f"--set {name}: {path} exists; it stays as it is")
    return path


def error_lines(columns: dict[str, StrideErrors]) -> list[str]:
    """Table of RMS errors by kind, a column for each prediction."""
    lines = [
        "RMS of predicted minus measured".ljust(34)
        + "".join(f"{n:>16}" for n in columns)
    ]
    for key, (label, scale, unit) in UNITS.items():
        cells = [
            f"{scale * errors.summary()[key]:.3f} {unit}" for errors in columns.values()
        ]
        lines.append(label.ljust(34) + "".join(f"{cell:>16}" for cell in cells))
    return lines


def fit_lines(found: TwinFit) -> list[str]:
    """Fitted values with intervals, and what the data do not determine."""
    result = found.estimate
    lines = [f"{'parameter':<28}{'start':>12}{'value':>12}   95 % interval"]
    rows = zip(
        found.names, found.start, result.values, result.interval, result.at_limit
    )
    for name, start, value, (low, high), limit in rows:
        interval = "undetermined" if math.isnan(low) else f"{low:.4g} to {high:.4g}"
        interval += ", at its bound" if limit else ""
        lines.append(f"{name:<28}{start:>12.5g}{value:>12.5g}   {interval}")
    return lines + [
        f"not determined: {text}" for text in undetermined(found.names, result)
    ]


def undetermined(names: tuple[str, ...], result: ParameterEstimate) -> list[str]:
    """Parameters that the data do not determine, and pairs of which they give only a combination."""
    out = [n for n, low in zip(names, result.interval[:, 0]) if math.isnan(low)]
    for i, row in enumerate(result.correlation):
        for j in range(i):
            if abs(row[j]) > CORRELATED:
                out.append(
                    f"{names[j]} apart from {names[i]} (correlation {row[j]:.3f})"
                )
    return out


def _errors(errors: StrideErrors) -> dict[str, float]:
    found, units = errors.summary(), UNITS.items()
    return {
        f"{key}_{unit}": round(scale * found[key], 4) for key, (_, scale, unit) in units
    }


def _number(value: float) -> float | None:
    return round(float(value), 3) if math.isfinite(value) else None
