"""Parameters with which the model explains a bag, fitted to some of its strides.

A parameter is named by its place, `robot.leg.young_modulus`, `scene.floor.friction[0]`,
`servo.lag`, or by one of the short names in `SHORT`. Without an index a value per leg is equal for
all legs; any other list needs one. The whole bag is simulated for every trial; the residuals are
those of the strides of the fit, the last strides are held out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import ConfigError, leaves
from slot_core.progress import untold
from slot_core.refusal import DivergenceError
from slot_core.robot import LEGS
from slot_lab.calibration.experiments import PredictionError
from slot_lab.calibration.fit import (
    FitProblem,
    Parameter,
    ParameterEstimate,
    estimate,
    fit,
)
from slot_lab.twin.prediction import ModelParts, measured_track, predict
from slot_lab.twin.recorded import BagRecording
from slot_lab.twin.settings import TwinSettings
from slot_lab.twin.strides import StrideErrors, Strides, residuals, stride_errors

SHORT = {
    "friction": ("scene.floor.friction",),
    "young_modulus": ("robot.leg.young_modulus",),
    "mass": ("robot.torso.mass",),
    "lag": ("servo.lag",),
    "tendon_offset": tuple(f"scene.tendons.slack[{leg}]" for leg in range(len(LEGS))),
}
# Narrower than the bounds of the settings, which allow any robot.
BOUNDS = {"scene.floor.friction": (0.02, 2.0), "scene.tendons.slack": (-0.003, 0.006)}
PLACE = re.compile(r"(robot|scene|servo)\.([a-z_.]+)(?:\[([0-3])\])?")
RunAll = Callable[[Callable[[Array], Array], Sequence[Array]], Sequence[Array]]


@dataclass(frozen=True)
class TwinFit:
    """Result of a fit."""

    names: tuple[str, ...]
    start: Array  # (p,)
    estimate: ParameterEstimate
    converged: bool
    parts: ModelParts  # with the fitted values
    seen: tuple[
        StrideErrors, StrideErrors
    ]  # of the strides of the fit, before and after
    held_out: tuple[StrideErrors, StrideErrors]  # of those that it has not seen


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
        raise ConfigError(f"--fit: a parameter is named twice: {', '.join(found)}")
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
        raise ConfigError(f"--fit {place}: {name} is one number, without an index")
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
        number = float(value)
        if not isinstance(old, (tuple, list)):
            out[part][name] = number
        else:
            out[part][name] = [
                number if index in (None, k) else v for k, v in enumerate(old)
            ]
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
        **{k: config.replace(getattr(parts, k), v) for k, v in given.items() if v},
    )


def serially(
    call: Callable[[Array], Array], points: Sequence[Array]
) -> Sequence[Array]:
    """Calls one after the other, in this process."""
    return [call(point) for point in points]


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
    if recorded.angles.measured and any(name.startswith("servo.") for name in names):
        raise ConfigError(
            "--fit of the servo needs its commands: --angles /desired_joint_angles"
        )
    seen, held_out = strides.split(settings.held_out)
    call = partial(stride_residuals, recorded, parts, tuple(names), (seen, settings))
    measured = measured_track(recorded.motion)
    blocks = residuals(measured, measured, seen, settings)
    if len(blocks) <= len(names):
        raise ConfigError(
            f"{len(blocks)} windows of {settings.window} strides for {len(names)} parameters: no"
            " intervals; record longer or fit fewer"
        )
    groups = np.repeat(np.arange(len(blocks)), [block.size for block in blocks])
    free = tuple(parameter(parts, name) for name in names)
    zero, one = np.zeros(len(groups)), np.ones(len(groups))
    problem = FitProblem(
        free,
        lambda values: run_all(call, [values])[0],
        zero,
        one,
        partial(run_all, call),
    )
    found = fit(problem, starts, say, tell)
    result = estimate(problem, found.values, groups)
    best = changed(parts, names, found.values)
    before, after = (predict(recorded, each, settings) for each in (parts, best))
    return TwinFit(
        tuple(names),
        np.array([p.start for p in free]),
        result,
        found.converged,
        best,
        (stride_errors(before, measured, seen), stride_errors(after, measured, seen)),
        (
            stride_errors(before, measured, held_out),
            stride_errors(after, measured, held_out),
        ),
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
    blocks = residuals(predicted, measured_track(recorded.motion), *seen)
    return np.concatenate([block.ravel() for block in blocks])


def _split(place: str) -> tuple[str, str, int | None]:
    match = PLACE.fullmatch(place)
    assert match is not None
    part, name, index = match.groups()
    return part, name, None if index is None else int(index)


def _is_number(value: Any, meta: Mapping[str, Any]) -> bool:
    first = value[0] if isinstance(value, tuple) and value else value
    return "low" in meta and isinstance(first, float)
