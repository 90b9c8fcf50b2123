"""Alignment of two recordings in time, and the errors between them.

As the paper's validation does it (section V): the series to be judged is interpolated at the times
of the reference, then RMSE, MAE and NRMSE are computed over the common span.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from slot_core.robot import Array


@dataclass(frozen=True)
class Errors:
    """Errors of a series against its reference; rmse and mae in the unit of the series."""

    rmse: float
    mae: float
    nrmse: float  # rmse over the range of the reference; NaN where the reference is constant


def align(t: Array, values: Array, t_reference: Array) -> tuple[NDArray[np.intp], Array]:
    """Interpolate `values` (n, ...) at t (n,) to the reference's times within the common span.

    Returns (index, aligned): the indices of `t_reference` that lie within [t[0], t[-1]], and the
    values there, linear in between. Raises ValueError when `t` does not increase or the spans do
    not meet.
    """
    if len(t) != len(values) or np.any(np.diff(t) <= 0):
        raise ValueError(f"times must increase, one per value: {len(t)} for {len(values)} values")
    index = np.flatnonzero((t_reference >= t[0]) & (t_reference <= t[-1]))
    if not len(index):
        raise ValueError(f"no common span: [{t[0]}, {t[-1]}] s and the reference's times")
    flat = np.reshape(values, (len(t), -1))
    columns = [np.interp(t_reference[index], t, column) for column in flat.T]
    return index, np.column_stack(columns).reshape(len(index), *np.shape(values)[1:])


def errors(values: Array, reference: Array) -> Errors:
    """RMSE, MAE and NRMSE of equally shaped arrays; NRMSE = RMSE / (max - min of the reference)."""
    if np.shape(values) != np.shape(reference):
        raise ValueError(f"shapes differ: {np.shape(values)} against {np.shape(reference)}")
    difference = np.asarray(values) - np.asarray(reference)
    rmse = math.sqrt(float(np.mean(np.square(difference))))
    span = float(np.ptp(reference))
    return Errors(rmse, float(np.mean(np.abs(difference))), rmse / span if span > 0 else math.nan)
