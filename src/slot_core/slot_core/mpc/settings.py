"""Settings of the MPC: `config/mpc.yaml`."""

import math
from dataclasses import dataclass

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import quantity
from slot_core.gait.gait import Vector3
from slot_core.mpc.model import FEET


@dataclass(frozen=True)
class Weights:
    """Diagonals of Q (per squared rad, m, rad/s, m/s) and R (per squared N), axes x, y, z."""

    angle: Vector3 = quantity("weight of roll, pitch, yaw", "1/rad^2", 0, 1e9)
    position: Vector3 = quantity("weight of the position", "1/m^2", 0, 1e9)
    rate: Vector3 = quantity(
        "weight of the angular velocity", "s^2/rad^2", 0, 1e9
    )
    velocity: Vector3 = quantity("weight of the velocity", "s^2/m^2", 0, 1e9)
    force: Vector3 = quantity(
        "weight of a leg's deviation from its reference force",
        "1/N^2",
        1e-12,
        1e9,
    )

    @property
    def q(self) -> Array:
        """(12,) diagonal of Q."""
        return np.concatenate(
            [self.angle, self.position, self.rate, self.velocity]
        )

    @property
    def r(self) -> Array:
        """(12,) diagonal of R."""
        return np.tile(self.force, FEET)


@dataclass(frozen=True)
class MpcSolverSettings:
    """Termination criteria of the solver."""

    tolerance_abs: float = quantity(
        "largest absolute duality gap of a solution", "", 1e-12, 1e-1
    )
    tolerance_rel: float = quantity(
        "largest relative residual and duality gap of a solution",
        "",
        1e-12,
        1e-1,
    )
    iterations: int = quantity(
        "largest number of iterations of the solver", "", 1, 100000
    )


@dataclass(frozen=True)
class Acceptance:
    """Limits of the inputs and of an accepted solution."""

    violation_max: float = quantity(
        "largest accepted violation of a force limit", "N", 0, 1
    )
    time_budget: float = quantity(
        "longest time for checks, update and solve", "s", 0, math.inf
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
    horizon: int = quantity("number of stages of the horizon", "", 1, 100)
    force_max: float = quantity("largest normal force of a leg", "N", 0, 100)


def read_mpc() -> MpcSettings:
    """The settings of `config/mpc.yaml`; raises ConfigError."""
    return config.read(MpcSettings, "mpc")
