"""Errors of a run against a measurement, as the paper's tables state them.

With e_i = run_i - measured_i and the range W = max - min of the measurement:

    RMSE = sqrt(mean e^2),  MAE = mean |e|,  NRMSE = RMSE / W,  mean error = |mean e|,
    error = |mean e| / W,   accuracy = 1 - error.

The paper gives no formulas. These reproduce its table of the single leg to its digits: at the base
W = 5.20 mm / 5.87 % = 88.6 mm, and 2.23 mm / 88.6 mm = 2.51 %, accuracy 97.49 %; likewise at the
other points. Its accuracy thus counts the mean error only: one that oscillates about zero is 100 %
accurate, whatever its RMSE.

The intervals are those of a moving block bootstrap (H. R. Kuensch, Ann. Statist. 17, 1989, 1217):
errors of neighbouring samples are alike, so blocks of them are drawn; range and alignment are kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slot_core.arrays import Array

NAMES = ("rmse", "mae", "nrmse", "mean_error", "error", "accuracy")
DRAWS = 1000
LEVEL = 0.95
LEAST_BLOCKS = 3  # of a series; with fewer there is no interval


@dataclass(frozen=True)
class Errors:
    """Metrics of one coordinate by name, each with its 95 % interval (NaN: series too short).

    rmse, mae and mean_error in the unit of the series, the others as parts of one.
    """

    value: dict[str, float]
    interval: dict[str, tuple[float, float]]
    span: float  # W, range of the measurement
    samples: int


def errors(run: Array, measured: Array, block: int, seed: int = 0) -> Errors:
    """Errors of series (n,) with blocks of `block` samples; raises ValueError for other shapes."""
    if run.shape != measured.shape or run.ndim != 1 or not len(run):
        raise ValueError(
            f"shapes differ or are empty: {run.shape} and {measured.shape}"
        )
    off, span = run - measured, float(np.ptp(measured))
    rmse, mae, mean = (float(part[0]) for part in _parts(off[None]))
    value = metrics(rmse, mae, mean, span)
    interval = dict.fromkeys(NAMES, (math.nan, math.nan))
    if len(off) >= LEAST_BLOCKS * block:
        drawn = _parts(_drawn(off, block, np.random.default_rng(seed)))
        bounds = [np.quantile(v, [(1 - LEVEL) / 2, (1 + LEVEL) / 2]) for v in drawn]
        means = np.abs(bounds[2])
        least = 0.0 if bounds[2][0] < 0.0 < bounds[2][1] else means.min()
        low = metrics(bounds[0][0], bounds[1][0], least, span)
        high = metrics(bounds[0][1], bounds[1][1], means.max(), span)
        ends = {name: sorted((float(low[name]), float(high[name]))) for name in NAMES}
        interval = {name: (first, last) for name, (first, last) in ends.items()}
    return Errors(value, interval, span, len(off))


def metrics(rmse: float, mae: float, mean: float, span: float) -> dict[str, float]:
    """Metrics by name from RMSE, MAE, mean error and range; NaN where the range is zero."""
    width, mean = (span if span > 0 else math.nan), abs(mean)
    return dict(
        zip(NAMES, (rmse, mae, rmse / width, mean, mean / width, 1.0 - mean / width))
    )


def _parts(off: Array) -> tuple[Array, Array, Array]:
    """RMSE, MAE and mean error (with sign) of rows of errors (m, n): (m,) each."""
    return (
        np.sqrt(np.mean(off**2, axis=1)),
        np.mean(np.abs(off), axis=1),
        off.mean(axis=1),
    )


def _drawn(off: Array, block: int, rng: np.random.Generator) -> Array:
    """(DRAWS, n) errors put together from blocks that begin anywhere."""
    count = math.ceil(len(off) / block)
    starts = rng.integers(0, len(off) - block + 1, size=(DRAWS, count))
    index = (starts[:, :, None] + np.arange(block)).reshape(DRAWS, -1)[:, : len(off)]
    return np.asarray(off[index])
