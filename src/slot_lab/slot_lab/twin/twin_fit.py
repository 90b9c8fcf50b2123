"""Parameters with which the model explains a bag, fitted to some of its strides, and their file.

A parameter is named by its place, `robot.leg.young_modulus`, `scene.floor.friction[0]`,
`servo.lag`, or by one of the short names in `SHORT`. Without an index a value per leg is equal for
all legs; any other list needs one. The whole bag is simulated for every trial; the residuals are
taken over the strides of the fit, the last strides are held out.

The parameter set has, beside the keys of slot_lab/calibration/parameter_file.py:

robot, scene, servo  values by dotted name; they replace the values of robot.yaml, of the scene that
                     names the set, and of servo.yaml
data                 recording, its topics or columns, strides of the fit and strides held out
errors               RMS of predicted minus measured, before and after, of both
confidence           95 % intervals by place; strides are taken as independent of each other
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.command_line import untold
from slot_core.config import ConfigError, leaves
from slot_core.refusal import DivergenceError, quoted
from slot_core.robot import LEGS, read_parameters
from slot_lab.calibration import parameter_file
from slot_lab.calibration.fit import (
    FitProblem,
    Parameter,
    ParameterEstimate,
    PredictionError,
    RunAll,
    estimate,
    fit,
)
from slot_lab.twin.prediction import ModelParts, predict
from slot_lab.twin.strides import (
    BagRecording,
    StrideErrors,
    Strides,
    TwinSettings,
    residuals,
    stride_errors,
)
from slot_lab.workers import serially

SHORT = {
    "friction": ("scene.floor.friction",),
    "young_modulus": ("robot.leg.young_modulus",),
    "mass": ("robot.torso.mass",),
    "lag": ("servo.lag",),
    "tendon_offset": tuple(
        f"scene.tendons.slack[{leg}]" for leg in range(len(LEGS))
    ),
}
# Narrower than the bounds of the settings, which allow any robot.
BOUNDS = {
    "scene.floor.friction": (0.02, 2.0),
    "scene.tendons.slack": (-0.003, 0.006),
}
PLACE = re.compile(r"(robot|scene|servo)\.([a-z_.]+)(?:\[([0-3])\])?")
HEAD = """# Parameter set of the robot; `parameters` of a scene, or in config/robot.yaml, names it.
# Written by scripts/twin; slot_lab/twin/twin_fit.py describes the keys.
"""
# beyond it the data determine a combination, not the parameters
CORRELATED = 0.95
UNITS = {
    "displacement": ("displacement of a stride", 1e3, "mm"),
    "place": ("place after 4 strides", 1e3, "mm"),
    "turn": ("turn of a stride", 180.0 / math.pi, "deg"),
    "height": ("mean height of a stride", 1e3, "mm"),
    "tilt": ("mean tilt of a stride", 180.0 / math.pi, "deg"),
}


@dataclass(frozen=True)
class TwinFit:
    """Result of a fit."""

    names: tuple[str, ...]
    start: Array  # (p,)
    estimate: ParameterEstimate
    converged: bool
    parts: ModelParts  # with the fitted values
    seen: Sequence[StrideErrors]  # before and after, of the strides of the fit
    # before and after, of the strides held out
    held_out: Sequence[StrideErrors]


def places(names: Sequence[str]) -> tuple[str, ...]:
    """Places of parameters given by place or short name; raises ConfigError."""
    found = [place for name in names for place in SHORT.get(name, (name,))]
    for place in found:
        if not PLACE.fullmatch(place):
            raise ConfigError(
                f"--fit {place}: expected one of {', '.join(SHORT)}, or a number below robot.,"
                " scene. or servo."
            )
    if len(set(found)) < len(found):
        raise ConfigError(
            f"--fit: a parameter is named twice: {', '.join(found)}"
        )
    return tuple(found)


def parameter(parts: ModelParts, place: str) -> Parameter:
    """The free parameter of a place, with its value and bounds; raises ConfigError."""
    part, name, index = _split(place)
    known = {
        n: (v, meta)
        for n, v, meta in leaves(getattr(parts, part))
        if _is_number(v, meta)
    }
    if name not in known:
        raise ConfigError(f"--fit {place}: {part} has no number {name}")
    value, meta = known[name]
    if index is not None and not isinstance(value, tuple):
        raise ConfigError(
            f"--fit {place}: {name} is one number, without an index"
        )
    if isinstance(value, tuple):
        index = 0 if index is None and len(value) == len(LEGS) else index
        if index is None or index >= len(value):
            raise ConfigError(
                f"--fit {place}: expected an index of {name}, 0 to {len(value) - 1}"
            )
        value = value[index]
    low, high = BOUNDS.get(f"{part}.{name}", (meta["low"], meta["high"]))
    if not low <= value <= high:
        raise ConfigError(
            f"--fit {place}: its value {value:g} is outside [{low:g}, {high:g}]"
        )
    return Parameter(place, value, low, high)


def changes(
    parts: ModelParts, names: Sequence[str], values: Sequence[float] | Array
) -> dict[str, dict[str, Any]]:
    """Changed values by dotted name, for each of robot, scene, servo."""
    out: dict[str, dict[str, Any]] = {"robot": {}, "scene": {}, "servo": {}}
    for place, value in zip(names, values):
        part, name, index = _split(place)
        old = out[part].get(name) or attrgetter(f"{part}.{name}")(parts)
        out[part][name] = (
            [
                float(value) if index in (None, k) else v
                for k, v in enumerate(old)
            ]
            if isinstance(old, (tuple, list))
            else float(value)
        )
    if "lag" in out["servo"]:
        out["servo"]["model"] = "torque_speed"  # the pid has none
    return out


def changed(
    parts: ModelParts, names: Sequence[str], values: Sequence[float] | Array
) -> ModelParts:
    """The model with other values; raises ConfigError."""
    given = changes(parts, names, values)
    return replace(
        parts,
        **{
            k: config.replace(getattr(parts, k), v)
            for k, v in given.items()
            if v
        },
    )


def fit_twin(
    recorded: BagRecording,
    parts: ModelParts,
    names: Sequence[str],
    strides: Strides,
    settings: TwinSettings,
    *,
    run_all: RunAll = serially,
    starts: int = 1,
    say: Callable[[str], None] = print,
    tell: Callable[[str], object] = untold,
) -> TwinFit:
    """Fit the parameters at `names` (places); raises ConfigError, FitError, PredictionError."""
    if recorded.angles.measured and any(
        name.startswith("servo.") for name in names
    ):
        raise ConfigError(
            "--fit of the servo needs its commands: --angles /desired_joint_angles"
        )
    seen, held_out = strides.split(settings.held_out)
    call = partial(
        stride_residuals, recorded, parts, tuple(names), (seen, settings)
    )
    measured = recorded.motion
    blocks = residuals(measured, measured, seen, settings)
    if len(blocks) <= len(names):
        raise ConfigError(
            f"{len(blocks)} windows of {settings.window} strides for {len(names)} parameters: no"
            " intervals; record longer or fit fewer"
        )
    groups = np.repeat(np.arange(len(blocks)), [block.size for block in blocks])
    free = tuple(parameter(parts, name) for name in names)
    zero, one = np.zeros(len(groups)), np.ones(len(groups))
    problem = FitProblem(free, call, zero, one, run_all)
    found = fit(problem, starts, say, tell)
    result = estimate(problem, found.values, groups)
    best = changed(parts, names, found.values)
    moved = [predict(recorded, each, settings) for each in (parts, best)]
    return TwinFit(
        names=tuple(names),
        start=np.array([p.start for p in free]),
        estimate=result,
        converged=found.converged,
        parts=best,
        seen=[stride_errors(m, measured, seen) for m in moved],
        held_out=[stride_errors(m, measured, held_out) for m in moved],
    )


def stride_residuals(
    recorded: BagRecording,
    parts: ModelParts,
    names: tuple[str, ...],
    seen: tuple[Strides, TwinSettings],
    values: Array,
) -> Array:
    """(n,) residuals of the strides at values of the parameters; raises PredictionError."""
    try:
        predicted = predict(recorded, changed(parts, names, values), seen[1])
    except (DivergenceError, ConfigError) as error:
        raise PredictionError(str(error)) from None
    blocks = residuals(predicted, recorded.motion, *seen)
    return np.concatenate([block.ravel() for block in blocks])


def _split(place: str) -> tuple[str, str, int | None]:
    match = PLACE.fullmatch(place)
    assert match is not None
    part, name, index = match.groups()
    return part, name, None if index is None else int(index)


def _is_number(value: Any, meta: Mapping[str, Any]) -> bool:
    first = value[0] if isinstance(value, tuple) and value else value
    return "low" in meta and isinstance(first, float)


def record_fit(
    recorded: BagRecording,
    parts: ModelParts,
    start: str,
    found: TwinFit,
    note: str,
) -> dict[str, Any]:
    """Content of the file; start: the set that the fit started from."""
    fitted = [parameter_file.rounded(value) for value in found.estimate.values]
    values, given = (
        dict(read_parameters(start)),
        changes(parts, found.names, fitted),
    )
    for name in values.keys() & given["robot"].keys():
        values[name] = given["robot"].pop(name)
    kept = {
        part: read_parameters(start, part) | new for part, new in given.items()
    }
    result = found.estimate
    end = "" if found.converged else ", not converged"
    return {
        "values": values,
        **{part: new for part, new in kept.items() if new},
        "from": f"fit of the twin from {start}{end}",
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
            for name, pair in (
                ("fit", found.seen),
                ("held_out", found.held_out),
            )
        },
        "confidence": {
            n: parameter_file.interval_of(row)
            for n, row in zip(found.names, result.interval)
        },
        "correlation": parameter_file.correlation_of(result.correlation),
    }


def write_set(name: str, content: dict[str, Any]) -> Path:
    """Write a new set of `config/parameters`; raises ConfigError if there is one of that name."""
    path = place_of(name)
    parameter_file.write(path, content, HEAD)
    return path.resolve()


def place_of(name: str) -> Path:
    """Path of a new set; raises ConfigError if the name is taken or is no name of a file."""
    path = config.config_dir() / "parameters" / f"{name}.yaml"
    if not name or not name.replace("_", "").replace("-", "").isalnum():
        raise ConfigError(
            f"--set {quoted(name)}: expected letters, digits, _ and -"
        )
    if path.exists():
        raise ConfigError(f"--set {name}: {path} exists; it stays as it is")
    return path


def error_lines(columns: dict[str, StrideErrors]) -> list[str]:
    """Table of RMS errors by kind, a column for each prediction."""
    rows = {"RMS of predicted minus measured": list(columns)}
    for key, (label, scale, unit) in UNITS.items():
        rows[label] = [
            f"{scale * errors.summary()[key]:.3f} {unit}"
            for errors in columns.values()
        ]
    return [
        label.ljust(34) + "".join(f"{cell:>16}" for cell in cells)
        for label, cells in rows.items()
    ]


def fit_lines(found: TwinFit) -> list[str]:
    """Fitted values with intervals, and what the data do not determine."""
    result = found.estimate
    lines = [f"{'parameter':<28}{'start':>12}{'value':>12}   95 % interval"]
    for name, start, value, (low, high), limit in zip(
        found.names,
        found.start,
        result.values,
        result.interval,
        result.at_limit,
    ):
        interval = (
            "undetermined" if math.isnan(low) else f"{low:.4g} to {high:.4g}"
        )
        interval += ", at its bound" if limit else ""
        lines.append(f"{name:<28}{start:>12.5g}{value:>12.5g}   {interval}")
    return lines + [
        f"not determined: {text}" for text in undetermined(found.names, result)
    ]


def undetermined(
    names: tuple[str, ...], result: ParameterEstimate
) -> list[str]:
    """Parameters that the data do not determine, and pairs of which they give only a combination."""
    out = [n for n, low in zip(names, result.interval[:, 0]) if math.isnan(low)]
    return out + [
        f"{names[j]} apart from {names[i]} (correlation {row[j]:.3f})"
        for i, row in enumerate(result.correlation)
        for j in range(i)
        if abs(row[j]) > CORRELATED
    ]


def _errors(errors: StrideErrors) -> dict[str, float]:
    found = errors.summary()
    return {
        f"{key}_{unit}": round(scale * found[key], 4)
        for key, (_, scale, unit) in UNITS.items()
    }
