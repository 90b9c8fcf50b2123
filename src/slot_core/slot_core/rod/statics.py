"""Equilibria of a rod: continuation in the load, with its stability from the tangent's pivots.

The load factor goes from 0, the present loads, to 1, the wanted ones. Each step is Newton's method
from the last equilibrium; it counts where it converges and no section turns by much more than at
the rate of the step before, else the step is halved. So the path stays on its branch: at a fold it
ends, in place of jumping to another one.
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

FIRST_PROBE = 64  # part of the first step that finds the first rate of turn
LEAVE_STEPS = 60  # damped steps from an unstable equilibrium, at most
GROWTH = 1.5  # of the step from one equilibrium to the next


class Branch(Enum):
    """Which path of equilibria a state lies on."""

    PRIMARY = "primary"  # connected to the start, and no pivot has changed its sign
    UNSTABLE = "unstable"  # the tangent has negative pivots
    SECONDARY = "secondary"  # stable again, after a bifurcation or beyond a critical load


@dataclass(frozen=True)
class StaticSettings:
    """How equilibria are found.

    stay_stable: leave a branch where it loses its stability, towards the side of `side` (+1, -1) of
    its critical shape; else follow it.
    """

    stay_stable: bool = False
    side: int = 1
    first_step: float = 0.1  # of the load
    least_step: float = 1e-7
    largest_turn: float = 0.5  # rad, of any section in one step
    turn_growth: float = 3.0  # of the turn per load from step to step
    turn_floor: float = 1e-4  # rad, turns that no rate is asked for
    iterations: int = 40
    tolerance: float = 1e-10  # of Newton's increment, rad and lengths
    critical_tolerance: float = 1e-6  # of the load

    def __post_init__(self) -> None:
        if self.side not in {-1, 1}:
            raise RodError(f"side {self.side} must be -1 or 1")
        if not 0.0 < self.least_step <= self.first_step <= 1.0:
            raise RodError(f"steps {self.least_step}, {self.first_step} must be within 0 .. 1")


@dataclass(frozen=True)
class Equilibrium:
    """What `solve_static` has found; the rod is in this state."""

    branch: Branch
    negative_pivots: int  # directions in which the equilibrium is unstable
    critical: tuple[float, ...]  # load factors at which a pivot changed its sign
    steps: int  # of the load
    iterations: int  # of Newton's method, in all

    @property
    def stable(self) -> bool:
        """Whether the energy has a minimum here; of flutter under a follower force it knows not."""
        return self.negative_pivots == 0


class EquilibriumError(ArithmeticError):
    """No equilibrium on the branch beyond `load_factor`, where the rod stands now."""

    def __init__(self, reason: str, load_factor: float, negative_pivots: int) -> None:
        super().__init__(
            f"{reason}; last equilibrium at load factor {load_factor:.6g} "
            f"with {negative_pivots} negative pivots"
        )
        self.load_factor = load_factor
        self.negative_pivots = negative_pivots


class RodLoads(NamedTuple):
    """Dead loads at the nodes and the follower force at the tip."""

    dead: Array  # (n, 3) N, N, N m
    follower: Array  # (2,) N

    def toward(self, other: RodLoads, factor: float) -> RodLoads:
        """The loads that lie between these and others."""
        return RodLoads(*(a + factor * (b - a) for a, b in zip(self, other)))


class _Path:
    """The equilibria from one load to another."""

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
        """Newton's method at a load factor from work.stage; negative pivots, None: it failed."""
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
        """Largest turn of a section up to a load factor, rad."""
        s = self.settings
        expected = self.rate * (factor - self.factor) if factor > self.factor else 0.0
        return min(s.largest_turn, s.turn_growth * expected + s.turn_floor)

    def bisect(self, low: float, high: float, negative: int) -> float:
        """Load factor between two where the number of negative pivots leaves `negative`."""
        start, stress = self.work.stage.copy(), self.work.stress.copy()
        while high - low > self.settings.critical_tolerance * high:
            middle = (low + high) / 2
            if self.correct(middle) == negative:
                low = middle
            else:
                high = middle
        self.work.stage[:], self.work.stress[:] = start, stress
        return (low + high) / 2

    def go(self, factor: float) -> bool:
        """Try the equilibrium at a larger load factor."""
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
                negative = self.leave(factor)
        turn = np.abs(self.work.stage - before[0])[:, 2].max()
        self.rate = math.inf if self.left_at == factor else turn / (factor - self.factor)
        self.factor, self.negative, self.steps = factor, negative, self.steps + 1
        return True

    def leave(self, factor: float) -> int:
        """From an unstable equilibrium down to a stable one: damped steps from the critical shape.

        Raises EquilibriumError where none is found.
        """
        work, mesh = self.work, self.mesh
        load, follower = self.begin.toward(self.end, factor)
        value, shape = self.critical_shape(load, follower)
        work.stage[:] += self.settings.side * self.settings.largest_turn / 10 * shape
        kernels.stress_of(mesh, work)
        shift = -20 * value
        for _ in range(LEAVE_STEPS):
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
        """Lowest eigenvalue of the tangent in the metric and its shape, largest angle or shift 1.

        The angle of the shape that is largest in size is positive.
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
        """Name of the branch reached."""
        if self.negative:
            return Branch.UNSTABLE
        return Branch.SECONDARY if self.critical else Branch.PRIMARY


def follow(
    mesh: Mesh, work: kernels.RodWork, begin: RodLoads, end: RodLoads, settings: StaticSettings
) -> Equilibrium:
    """Follow the equilibria from work.stage under the loads `begin` to the loads `end`.

    Leaves the equilibrium in work.stage. Raises EquilibriumError, with the last one in work.stage.
    """
    path = _Path(mesh, work, begin, end, settings)
    kernels.stress_of(mesh, work)
    negative = path.correct(0.0)
    if negative is None:
        raise EquilibriumError("the present state is not near an equilibrium", 0.0, 0)
    path.negative = negative
    step = settings.first_step / FIRST_PROBE
    while path.factor < 1.0:
        if path.go(min(1.0, path.factor + step)):
            step = max(GROWTH * step, settings.first_step if path.steps == 1 else 0.0)
            continue
        step /= 2
        if step < settings.least_step:
            raise EquilibriumError("the branch ends or folds", path.factor, path.negative)
    return Equilibrium(
        path.branch(), path.negative, tuple(path.critical), path.steps, path.iterations
    )
