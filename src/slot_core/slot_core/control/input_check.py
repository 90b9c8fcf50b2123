"""Checks of a policy's inputs and of its computing time: one line on the first fault."""

from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.control.policy import TendonPlan
from slot_core.gait.gait import GaitPreview
from slot_core.robot import LEGS

STATES, FEET = 12, len(LEGS)
EXCEED = " ms exceed "
GRAVITY_RANGE = (-20.0, 20.0)  # m/s^2, of an element
STAGE_TIME = (0.001, 0.1)  # s, shortest and longest time between stages


def state_fault(state: Array, most: float) -> str:
    """The fault of a state (12,), whose elements are at most `most`; empty if there is none."""
    return fault_of("state", state, (STATES,), -most, most)


def preview_fault(preview: GaitPreview, stages: int, most: float) -> str:
    """The fault of a preview, which has at least so many stages; empty if there is none."""
    return (
        fault_of("preview.dt", preview.dt, (), *STAGE_TIME)
        or fault_of("preview.contact", preview.contact, (stages, FEET), 0, 1)
        or fault_of(
            "preview.friction", preview.friction, (stages, FEET), 0, most
        )
        or fault_of(
            "preview.normal_force",
            preview.normal_force,
            (stages, FEET),
            -most,
            most,
        )
        or fault_of(
            "preview.tendon_angle",
            preview.tendon_angle,
            (stages, FEET),
            -most,
            most,
        )
        or fault_of(
            "preview.reference",
            preview.reference,
            (stages, STATES),
            -most,
            most,
        )
    )


def time_fault(elapsed: float, budget: float) -> str:
    """The fault of a plan that took `elapsed`, s, of a budget; empty if it was in time."""
    late = f"{elapsed * 1e3:.1f}{EXCEED}{budget * 1e3:g} ms"
    return late if elapsed > budget else ""


def is_late(plan: TendonPlan) -> bool:
    """Whether a plan, also a stopped one, names its computing time as the fault."""
    return EXCEED in plan.message


def fault_of(
    name: str, value: Any, shape: tuple[int, ...], low: float, high: float
) -> str:
    """The fault of an input of `shape`, or ""; two-dimensional inputs may have more rows."""
    try:
        array = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        return f"{name}: not numbers"
    usable = (
        array[: shape[0]].shape
        if array.ndim == len(shape) == 2
        else array.shape
    )
    if usable != shape:
        return f"{name}: shape {array.shape}, needs {shape}"
    # false for NaN
    if low <= array.min(initial=high) and array.max(initial=low) <= high:
        return ""
    index = tuple(np.argwhere(~((array >= low) & (array <= high)))[0].tolist())
    where = f"[{', '.join(map(str, index))}]" if index else ""
    return f"{name}{where} = {array[index]:g}: outside [{low:g}, {high:g}]"
