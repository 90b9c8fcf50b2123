"""Equilibria of a rod by continuation in the load; stability from the pivots of the tangent.

The load factor goes from 0, the loads at the start, to 1, the loads at the end. Each step is
Newton's method from the last equilibrium. A step is accepted if it converges and no section turns
by much more than at the rate of the step before; otherwise it is halved. The path therefore stays
on its branch: at a fold it ends and does not jump to another branch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from slot_core.robot import Array
from slot_core.rod import kernels
from slot_core.rod.model import Mesh, RodError

FIRST_PROBE = 64  # divisor of the first step, which measures the first rate of turn
DESCENT_STEPS = 60  # damped steps from an unstable equilibrium, at most
GROWTH = 1.5  # of the step from one equilibrium to the next


class Branch(Enum):
    """Branch of equilibria that a state lies on."""

    PRIMARY = "primary"  # connected to the start, and no pivot has changed its sign
    UNSTABLE = "unstable"  # the tangent has negative pivots
    SECONDARY = "secondary"  # stable again, after a bifurcation or beyond a critical load


@dataclass(frozen=True)
class StaticSettings:
    """Settings of the continuation.

    stay_stable: where a branch loses its stability, switch to the stable branch on the side `side`
    (+1, -1) of the critical shape; otherwise follow the unstable branch.

    Raises RodError for another side, or unless 0 < least_step <= first_step <= 1.
    """

    stay_stable: bool = False
    side: int = 1
    first_step: float = 0.1  # of the load factor
    least_step: float = 1e-7  # of the load factor
    largest_turn: float = 0.5  # rad, of any section in one step
    turn_growth: float = 3.0  # of the turn per load factor, from step to step
    turn_floor: float = 1e-4  # rad, a turn that is always allowed
    iterations: int = 40  # of Newton's method, at most
    tolerance: float = 1e-10  # of Newton's last increment, in rad and rod lengths
    critical_tolerance: float = 1e-6  # of critical load factors, relative

    def __post_init__(self) -> None:
        if self.side not in {-1, 1}:
            raise RodError(f"side {self.side} must be -1 or 1")
        if not 0.0 < self.least_step <= self.first_step <= 1.0:
            raise RodError(f"steps {self.least_step}, {self.first_step} must be within 0 .. 1")


@dataclass(frozen=True)
class Equilibrium:
    """Result of `solve_static`, which leaves the rod in the equilibrium."""

    branch: Branch
    negative_pivots: int  # directions in which the equilibrium is unstable
    critical: tuple[float, ...]  # load factors at which a pivot changed its sign
    steps: int  # of the load factor
    iterations: int  # of Newton's method, in total


class EquilibriumError(ArithmeticError):
    """No equilibrium was found beyond `load_factor`, whose equilibrium the rod is in."""

    def __init__(self, reason: str, load_factor: float, negative_pivots: int) -> None:
        super().__init__(
            f"{reason}; last equilibrium at load factor {load_factor:.6g} "
            f"with {negative_pivots} negative pivots"
        )
        self.load_factor = load_factor


class RodLoads(NamedTuple):
    """Nodal loads: dead loads at the nodes and the follower force at the tip."""

    dead: Array  # (n, 3) N, N, N m
    follower: Array  # (2,) N

    def toward(self, other: RodLoads, factor: float) -> RodLoads:
        """Linear interpolation: these loads at factor 0, the others at 1."""
        return RodLoads(*(a + factor * (b - a) for a, b in zip(self, other)))


class _Path:
    """Path of equilibria from the loads `begin` to the loads `end`."""

    def __init__(
        self,
        mesh: Mesh,
        work: kernels.RodWork,
        begin: RodLoads,
        end: RodLoads,
        settings: StaticSettings,
    ) -> None:
        self.mesh, self.work, self.settings = mesh, work, settings
        self.begin, self.end = begin, end
        self.factor, self.negative = 0.0, 0
        self.steps = self.iterations = 0
        self.critical: list[float] = []
        self.left_at: float | None = None  # load factor at which an unstable branch was left
        self.rate = math.inf  # rad, turn per load factor in the last step

    def correct(self, factor: float) -> int | None:
        """Newton's method at a load factor from work.stage; negative pivots, None if it fails."""
        start, stress = self.work.stage.copy(), self.work.stress.copy()
        size, negative, count = kernels.equilibrium(
            self.mesh, self.work, *self.begin.toward(self.end, factor), 0.0,
            self.settings.iterations, self.settings.tolerance,
        )  # fmt: skip
        self.iterations += count
        turn = np.abs(self.work.stage - start)[:, 2].max()
        if size < self.settings.tolerance and turn <= self.limit(factor):
            return int(negative)
        self.work.stage[:], self.work.stress[:] = start, stress
        return None

    def limit(self, factor: float) -> float:
        """Largest accepted turn of a section in the step to a load factor, rad."""
        s = self.settings
        expected = self.rate * (factor - self.factor) if factor > self.factor else 0.0
        return min(s.largest_turn, s.turn_growth * expected + s.turn_floor)

    def bisect(self, low: float, high: float, negative: int) -> float:
        """Load factor between low and high at which the number of negative pivots changes."""
        start, stress = self.work.stage.copy(), self.work.stress.copy()
        while high - low > self.settings.critical_tolerance * high:
            middle = (low + high) / 2
            if self.correct(middle) == negative:
                low = middle
            else:
                high = middle
        self.work.stage[:], self.work.stress[:] = start, stress
        return (low + high) / 2

    def advance(self, factor: float) -> bool:
        """Step to a larger load factor; False if no equilibrium was accepted there."""
        before = self.work.stage.copy(), self.work.stress.copy()
        negative = self.correct(factor)
        if negative is None:
            return False
        if negative != self.negative:
            after = self.work.stage.copy(), self.work.stress.copy()
            self.work.stage[:], self.work.stress[:] = before
            self.critical.append(self.bisect(self.factor, factor, self.negative))
            self.work.stage[:], self.work.stress[:] = after
            if negative > self.negative and self.settings.stay_stable:
                negative = self.descend(factor)
        turn = np.abs(self.work.stage - before[0])[:, 2].max()
        self.rate = math.inf if self.left_at == factor else turn / (factor - self.factor)
        self.factor, self.negative, self.steps = factor, negative, self.steps + 1
        return True

    def descend(self, factor: float) -> int:
        """Descend from an unstable equilibrium to a stable one by damped steps.

        The descent starts with a displacement along the critical shape and returns the number of
        negative pivots, 0. Raises EquilibriumError where no stable equilibrium is found.
        """
        work, mesh = self.work, self.mesh
        load, follower = self.begin.toward(self.end, factor)
        value, shape = self.critical_shape(load, follower)
        work.stage[:] += self.settings.side * self.settings.largest_turn / 10 * shape
        kernels.stress_of(mesh, work)
        shift = -20 * value
        for _ in range(DESCENT_STEPS):
            if shift < 1e-3 * abs(value):
                break
            size, negative, count = kernels.equilibrium(
                mesh, work, load, follower, shift, 10, self.settings.tolerance
            )
            self.iterations += count
            if not np.isfinite(size):
                break
            shift /= 2 if negative == 0 else 0.5
        size, negative, count = kernels.equilibrium(
            mesh, work, load, follower, 0.0, self.settings.iterations, self.settings.tolerance
        )
        self.iterations += count
        if not size < self.settings.tolerance or negative:
            raise EquilibriumError("no stable branch found", self.factor, self.negative)
        self.left_at = factor
        return 0

    def critical_shape(self, load: Array, follower: Array) -> tuple[float, Array]:
        """Lowest eigenvalue of the tangent in the metric, and its shape (n, 3).

        The shape is scaled so that its largest angle in absolute value is 1.
        """
        nodes = len(self.mesh.natural)
        matrix = np.zeros((3 * nodes, 3 * nodes))
        kernels.dense(self.mesh, self.work, load, follower, matrix)
        held = np.zeros((nodes, 3), dtype=bool)
        held[[0, -1]] = self.mesh.held
        free = np.flatnonzero(~held.ravel())
        value, vector = eigh(
            (matrix + matrix.T)[np.ix_(free, free)] / 2,
            np.diag(self.mesh.metric.ravel()[free]),
            subset_by_index=[0, 0],
        )
        shape = np.zeros((nodes, 3))
        shape.ravel()[free] = vector[:, 0]
        return float(value[0]), shape / shape[np.abs(shape[:, 2]).argmax(), 2]

    def branch(self) -> Branch:
        """Branch that was reached."""
        if self.negative:
            return Branch.UNSTABLE
        return Branch.SECONDARY if self.critical else Branch.PRIMARY


def follow(
    mesh: Mesh, work: kernels.RodWork, begin: RodLoads, end: RodLoads, settings: StaticSettings
) -> Equilibrium:
    """Follow the equilibria from work.stage under the loads `begin` to the loads `end`.

    The equilibrium is written to work.stage. Raises EquilibriumError where the path ends or folds;
    work.stage is then the last equilibrium.
    """
    path = _Path(mesh, work, begin, end, settings)
    kernels.stress_of(mesh, work)
    negative = path.correct(0.0)
    if negative is None:
        raise EquilibriumError("the present state is not near an equilibrium", 0.0, 0)
    path.negative = negative
    step = settings.first_step / FIRST_PROBE
    while path.factor < 1.0:
        if path.advance(min(1.0, path.factor + step)):
            step = max(GROWTH * step, settings.first_step if path.steps == 1 else 0.0)
            continue
        step /= 2
        if step < settings.least_step:
            raise EquilibriumError("the branch ends or folds", path.factor, path.negative)
    return Equilibrium(
        path.branch(), path.negative, tuple(path.critical), path.steps, path.iterations
    )
