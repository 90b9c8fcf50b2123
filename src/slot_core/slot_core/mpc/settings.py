"""Settings of the MPC: `config/mpc.yaml`, and the paper's policies in `config/mpc/`."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import choice, flag, quantity, text
from slot_core.gait.gait import Vector3
from slot_core.mpc.model import FEET
from slot_core.mpc.solver import MpcSolverSettings

FORCE_MPC = "force_mpc"  # policy with the settings as they are


@dataclass(frozen=True)
class Weights:
    """Diagonals of Q (per squared rad, m, rad/s, m/s) and R (per squared N), axes x, y, z."""

    angle: Vector3 = quantity("weight of roll, pitch, yaw", "1/rad^2", 0, 1e9)
    position: Vector3 = quantity("weight of the position", "1/m^2", 0, 1e9)
    rate: Vector3 = quantity("weight of the angular velocity", "s^2/rad^2", 0, 1e9)
    velocity: Vector3 = quantity("weight of the velocity", "s^2/m^2", 0, 1e9)
    force: Vector3 = quantity(
        "weight of a leg's deviation from its reference force", "1/N^2", 1e-12, 1e9
    )

    @property
    def q(self) -> Array:
        """(12,) diagonal of Q."""
        return np.concatenate([self.angle, self.position, self.rate, self.velocity])

    @property
    def r(self) -> Array:
        """(12,) diagonal of R."""
        return np.tile(self.force, FEET)


@dataclass(frozen=True)
class Acceptance:
    """Limits of the inputs and of an accepted solution."""

    violation_max: float = quantity(
        "largest accepted violation of a force limit", "N", 0, 1
    )
    time_budget: float = quantity(
        "longest time for checks, update and solve", "s", 0, math.inf
    )
    condition_max: float = quantity(
        "largest condition number of the Hessian, at the longest stage", "", 1, 1e12
    )
    input_max: float = quantity(
        "largest accepted magnitude of any input, SI units", "", 1, 1e9
    )


@dataclass(frozen=True)
class Fallback:
    """Fallback without a solution: u = u_ref + decay^n (u - u_ref)_last in its n-th cycle."""

    cycles: int = quantity(
        "largest number of cycles in a row without a solution", "", 0, 1000
    )
    decay: float = quantity(
        "factor of the last input's deviation per such cycle", "", 0, 1
    )


@dataclass(frozen=True)
class MpcSettings:
    """Settings of `config/mpc.yaml`."""

    weights: Weights
    solver: MpcSolverSettings
    acceptance: Acceptance
    fallback: Fallback
    map: str = choice("force map", "incremental", "paper")
    horizon: int = quantity("number of stages of the horizon", "", 1, 100)
    force_max: float = quantity("largest normal force of a leg", "N", 0, 100)


@dataclass(frozen=True)
class PaperTerms:
    """Terms of the paper's problem (`paper_problem.py`) beside weights and limits."""

    mass: float = quantity(
        "mass of the box, whose weight the normal forces balance", "kg", 0.1, 100
    )
    lever: Vector3 = quantity(
        "end of a leg's lever beyond its attachment: outward along x and y, downward",
        "m",
        0,
        1,
    )
    turning: bool = flag("whether levers, inertia and rates turn with the present yaw")
    drag: Vector3 = quantity("drag of the velocity", "1/s", 0, 10)
    balance_band: float = quantity(
        "largest imbalance of the normal forces", "N", 0, 100
    )
    friction: Vector3 = quantity(
        "friction of the pulled front leg, the released one, and the rear legs",
        "",
        0,
        2,
    )
    leg_axes: bool = flag(
        "whether friction is limited in the legs' axes, at the rear by a cone"
    )
    least_normal: float = quantity(
        "least normal force of all legs but the pulled one", "N", 0, 100
    )
    least_pull: float = quantity(
        "least force of the pulled leg along its axis", "N", 0, 10
    )
    pull: float = quantity("target of that force", "N", 0, 10)
    pull_weight: float = quantity(
        "weight of the front legs' forces along their axes; 0: without least_pull too",
        "1/N^2",
        0,
        1,
    )


@dataclass(frozen=True)
class PaperMpcSettings(MpcSettings):
    """Settings of a policy of the paper."""

    terms: PaperTerms = text("terms of its problem")


def read_mpc(policy: str = FORCE_MPC) -> MpcSettings:
    """The settings of `config/mpc.yaml`, or those of a policy of the paper; raises ConfigError."""
    return (
        config.read(MpcSettings, "mpc")
        if policy == FORCE_MPC
        else read_paper_mpc(policy)
    )


def read_paper_mpc(policy: str) -> PaperMpcSettings:
    """The settings of a policy of the paper; raises ConfigError.

    `config/mpc/<policy>.yaml` holds the terms of its problem and, by dotted name, what differs from
    `config/mpc.yaml`.
    """
    profile, where = config.load(f"mpc/{policy}"), f"mpc/{policy}.yaml"
    changes = dict(profile) if isinstance(profile, dict) else {}
    terms = changes.pop("terms", None)
    config.read(MpcSettings, "mpc")  # refused under its own name
    settings = config.build(
        PaperMpcSettings, {**config.load("mpc"), "terms": terms}, where
    )
    return config.replace(settings, changes, where)
