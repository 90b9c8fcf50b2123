"""The seven perturbations of the paper's stability analysis, its table and its metrics."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from slot_core.arrays import Array

HEIGHT, SPEED = 0.04, 0.08  # m, m/s: the references of the paper
DURATION = 25.0  # s
DT = 0.033  # s
NOISE = 0.001  # standard deviation on every state, SI
SETTLED = 0.01  # cost below which a run counts as settled
HEIGHT_BAND, TILT_BAND = 2e-3, 10e-3  # m, rad: where the torso counts as settled
ROLL, PITCH, P_Z, V_X = 0, 1, 5, 9  # indices in the state

CASES: Mapping[str, Mapping[int, float]] = {
    "Baseline": {},
    "Roll": {ROLL: 0.1},
    "Pitch": {PITCH: 0.1},
    "Height": {P_Z: 0.01},
    "Velocity": {V_X: 0.05},
    "Combined": {ROLL: 0.05, PITCH: 0.05, P_Z: 0.02, V_X: 0.03},
    "Noise": {},
}
"""Changes of the initial state by case, by index in the state; rad, m, m/s."""

TABLE = {
    "Baseline": (4.9739, 1.1665, 0.0000, 14.553),
    "Roll": (4.9719, 1.1659, 0.0000, 14.553),
    "Pitch": (4.7920, 1.1120, 0.0000, 13.695),
    "Height": (6.2248, 1.5397, 0.0000, 14.553),
    "Velocity": (2.3827, 0.1720, 0.0000, 10.098),
    "Combined": (3.6959, 0.7873, 0.0000, 12.606),
    "Noise": (2.3828, 0.2212, 0.4943, math.nan),
}
"""The paper's table: maximum, mean and final cost, settling time, s (NaN: did not settle)."""


@dataclass(frozen=True)
class PerturbedRun:
    """A perturbed run; the cost is NaN in steps without one."""

    time: Array  # (n,) s
    cost: Array  # (n,)
    height: Array  # (n,) m
    tilt: Array  # (n,) rad
    infeasible: int  # steps without an accepted solution

    @classmethod
    def of(cls, time: Any, cost: Any, states: Any, infeasible: int) -> PerturbedRun:
        """The run with states (n, 12)."""
        x = np.array(states)
        return cls(
            np.array(time), np.array(cost), x[:, P_Z], tilt(x[:, :3]), infeasible
        )


Runs = Mapping[str, Mapping[str, PerturbedRun]]  # by study and case


def courses_of(runs: Runs) -> dict[str, Any]:
    """The fields of all runs by study, case and their name."""
    return {
        f"{study}/{case}/{field}": value
        for study, by_case in runs.items()
        for case, run in by_case.items()
        for field, value in dataclasses.asdict(run).items()
    }


def runs_of(courses: Mapping[str, Any]) -> dict[str, dict[str, PerturbedRun]]:
    """The runs of `courses_of`."""
    fields: dict[str, dict[str, dict[str, Any]]] = {}
    for name, value in courses.items():
        study, case, field = name.split("/")
        fields.setdefault(study, {}).setdefault(case, {})[field] = value
    return {
        study: {case: PerturbedRun(**values) for case, values in by_case.items()}
        for study, by_case in fields.items()
    }


def settling_time(time: Array, inside: Array) -> float:
    """First time from which `inside` (n,) holds to the end; NaN if it does not hold at the end."""
    outside = np.flatnonzero(~inside)
    if not len(outside):
        return float(time[0])
    return float(time[outside[-1] + 1]) if outside[-1] + 1 < len(time) else math.nan


def metrics(run: PerturbedRun, height: float = HEIGHT) -> dict[str, float]:
    """The paper's metrics, and the time after which the torso stays at `height` (m) and level."""
    still = (np.abs(run.height - height) < HEIGHT_BAND) & (run.tilt < TILT_BAND)
    return {
        "max_cost": float(np.nanmax(run.cost)),
        "mean_cost": float(np.nanmean(run.cost)),
        "final_cost": float(run.cost[-1]),
        "settling_cost_s": settling_time(run.time, run.cost < SETTLED),
        "settling_s": settling_time(run.time, still),
        "infeasible": run.infeasible,
    }


def tilt(rpy: Array) -> Array:
    """(n,) angle between body z and the vertical, rad, of roll, pitch and yaw (n, 3)."""
    return np.arccos(np.clip(np.cos(rpy[..., 0]) * np.cos(rpy[..., 1]), -1.0, 1.0))
