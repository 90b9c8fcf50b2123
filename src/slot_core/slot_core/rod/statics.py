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

from slot_core.arrays import Array, Arrays
from slot_core.rod import kernels
from slot_core.rod.mesh import Mesh
from slot_core.rod.model import need, need_positive

# divisor of the first step, which measures the first rate of turn
FIRST_PROBE = 64
DESCENT_STEPS = 60  # damped steps from an unstable equilibrium, at most
GROWTH = 1.5  # of the step from one equilibrium to the next


class Branch(Enum):
    """Branch of equilibria that a state lies on."""

    # connected to the start, and no pivot has changed its sign
    PRIMARY = "primary"
    UNSTABLE = "unstable"  # the tangent has negative pivots
    SECONDARY = "secondary"  # stable again, after a bifurcation or beyond a critical load


@dataclass(frozen=True)
class StaticSettings:
    """Settings of the continuation.

    stay_stable: where a branch loses its stability, switch to the stable branch on the side `side`
    (+1, -1) of the critical shape; otherwise follow the unstable branch.

    Raises RodError for another side, unless 0 < least_step <= first_step <= 1, or for
    a tolerance that is not above 0.
    """

    stay_stable: bool = False
    side: int = 1
    first_step: float = 0.1  # of the load factor
    least_step: float = 1e-7  # of the load factor
    largest_turn: float = 0.5  # rad, of any section in one step
    turn_growth: float = 3.0  # of the turn per load factor, from step to step
    turn_floor: float = 1e-4  # rad, a turn that is always allowed
    iterations: int = 40  # of Newton's method, at most
    # of Newton's last increment, in rad and rod lengths
    tolerance: float = 1e-10
    critical_tolerance: float = 1e-6  # of critical load factors, relative

    def __post_init__(self) -> None:
        least, first = self.least_step, self.first_step
        tolerances = (self.tolerance, self.critical_tolerance)
        need(self.side in {-1, 1}, f"side {self.side} must be -1 or 1")
        need(
            0.0 < least <= first <= 1.0,
            f"steps {least}, {first} must be within 0 .. 1",
        )
        need_positive("tolerances", *tolerances)


@dataclass(frozen=True)
class Equilibrium:
    """Result of `solve_static`, which leaves the rod in the equilibrium."""

    branch: Branch
    negative_pivots: int  # directions in which the equilibrium is unstable
    # load factors at which a pivot changed its sign
    critical: tuple[float, ...]
    steps: int  # of the load factor
    iterations: int  # of Newton's method, in total


class EquilibriumError(ArithmeticError):
    """No equilibrium was found beyond `load_factor`, whose equilibrium the rod is in."""

    def __init__(
        self, reason: str, load_factor: float, negative_pivots: int
    ) -> None:
        super().__init__(
            f"{reason}; last equilibrium at load factor {load_factor:.6g} "
            f"with {negative_pivots} negative pivots"
        )
        self.load_factor = load_factor


class RodLoads(NamedTuple):
    """Dead forces at the nodes, dead moment and follower force at the tip, and tendons."""

    dead: Array  # (N, 3) N
    moment: Array  # (3,) N m
    follower: Array  # (3,) N, along the axes of the tip's section
    tendon: Array  # (m, 3) pull (N), length (m), stiffness (N/m)

    def toward(self, other: RodLoads, factor: float) -> RodLoads:
        """Linear interpolation: these loads at factor 0, the others at 1."""
        return RodLoads(*(a + factor * (b - a) for a, b in zip(self, other)))


class _Path:
    """Path of equilibria from the loads `begin` to the loads `end`."""

    def __init__(
        self,
        mesh: Mesh,
        work: Arrays,
        begin: RodLoads,
        end: RodLoads,
        settings: StaticSettings,
    ) -> None:
        self.mesh, self.work, self.settings = mesh, work, settings
        self.begin, self.end = begin, end
        self.place = work.stage[len(mesh.rod.mass) - 1].copy()  # m, of the tip
        self.factor, self.negative = 0.0, 0
        self.steps = self.iterations = 0
        self.critical: list[float] = []
        # rad, turn per load factor in the last step; infinite where an unstable branch was left
        self.rate = math.inf

    def correct(self, factor: float) -> int | None:
        """Newton's method at a load factor from the posture; negative pivots, None if it fails."""
        start, frames = self.work.posture.copy(), self.frames()
        size, negative, count = kernels.equilibrium(
            self.mesh,
            self.work,
            self.begin.toward(self.end, factor),
            self.place,
            0.0,
            self.settings.iterations,
            self.settings.tolerance,
        )
        self.iterations += count
        if size < self.settings.tolerance and self.turn(frames) <= self.limit(
            factor
        ):
            return int(negative)
        self.work.posture[:] = start
        return None

    def frames(self) -> Array:
        """(2 N + 6, 3) unit vectors of all segments and of the ends' sections."""
        work = self.work
        return np.concatenate(
            [work.begin, work.from_director, *work.stage_frame]
        )

    def turn(self, before: Array) -> float:
        """Largest turn of a segment or section from its unit vectors before, rad."""
        chord = np.linalg.norm(self.frames() - before, axis=1).max()
        return float(2 * np.arcsin(min(1.0, chord / 2)))

    def limit(self, factor: float) -> float:
        """Largest accepted turn of a section in the step to a load factor, rad."""
        s = self.settings
        expected = (
            self.rate * (factor - self.factor) if factor > self.factor else 0.0
        )
        return min(s.largest_turn, s.turn_growth * expected + s.turn_floor)

    def bisect(self, before: Array, low: float, high: float) -> float:
        """Load factor between low and high at which the number of negative pivots changes.

        before: the posture at the load factor low.
        """
        after = self.work.posture.copy()
        self.work.posture[:] = before
        while high - low > self.settings.critical_tolerance * high:
            middle = (low + high) / 2
            if not low < middle < high:
                break  # neighbouring numbers
            if self.correct(middle) == self.negative:
                low = middle
            else:
                high = middle
        self.work.posture[:] = after
        return (low + high) / 2

    def advance(self, factor: float) -> bool:
        """Step to a larger load factor; False if no equilibrium was accepted there."""
        before, frames = self.work.posture.copy(), self.frames()
        negative = self.correct(factor)
        if negative is None:
            return False
        if negative != self.negative:
            self.critical.append(self.bisect(before, self.factor, factor))
        descends = negative > self.negative and self.settings.stay_stable
        if descends:
            negative = self.descend(factor)
        turn = self.turn(frames) / (factor - self.factor)
        self.rate = math.inf if descends else turn
        self.factor, self.negative = factor, negative
        self.steps += 1
        return True

    def descend(self, factor: float) -> int:
        """Descend from an unstable equilibrium to a stable one by damped steps.

        The descent starts with a displacement along the critical shape and returns the number of
        negative pivots, 0. Raises EquilibriumError where no stable equilibrium is found.
        """
        work, mesh = self.work, self.mesh
        loads = self.begin.toward(self.end, factor)
        value, shape = self.critical_shape(loads)
        kernels.push_aside(
            mesh,
            work,
            loads,
            self.settings.side * self.settings.largest_turn / 10 * shape,
        )
        shift = -20 * value
        for _ in range(DESCENT_STEPS):
            if shift < 1e-3 * abs(value):
                break
            size, negative, count = kernels.equilibrium(
                mesh,
                work,
                loads,
                self.place,
                shift,
                10,
                self.settings.tolerance,
            )
            self.iterations += count
            if not np.isfinite(size):
                break
            shift /= 2 if negative == 0 else 0.5
        size, negative, count = kernels.equilibrium(
            mesh,
            work,
            loads,
            self.place,
            0.0,
            self.settings.iterations,
            self.settings.tolerance,
        )
        self.iterations += count
        if not size < self.settings.tolerance or negative:
            raise EquilibriumError(
                "no stable branch found", self.factor, self.negative
            )
        return 0

    def critical_shape(self, loads: RodLoads) -> tuple[float, Array]:
        """Lowest eigenvalue of the tangent in the metric, and its shape (4 N + 7,).

        The shape is scaled so that the largest turn of a segment, about an axis or about itself,
        is 1 in absolute value.
        """
        mesh, size = self.mesh, len(self.mesh.metric)
        matrix, free = np.zeros((size, size)), np.flatnonzero(mesh.free)
        kernels.dense(mesh, self.work, loads, matrix)
        value, vector = eigh(
            (matrix + matrix.T)[np.ix_(free, free)] / 2,
            np.diag(mesh.metric[free]),
            subset_by_index=[0, 0],
        )
        shape = np.zeros(size)
        shape[free] = vector[:, 0]
        rows = shape[4:-3].reshape(-1, 4)
        step = np.diff(rows[:, :3], axis=0) / mesh.rod.rest_length[:-1, None]
        turns = np.concatenate([step.ravel(), rows[:-1, 3]])
        return float(value[0]), shape / turns[np.abs(turns).argmax()]

    def branch(self) -> Branch:
        """Branch that was reached."""
        if self.negative:
            return Branch.UNSTABLE
        return Branch.SECONDARY if self.critical else Branch.PRIMARY


def follow(
    mesh: Mesh,
    work: Arrays,
    begin: RodLoads,
    end: RodLoads,
    settings: StaticSettings,
) -> Equilibrium:
    """Follow the equilibria from work's posture under the loads `begin` to the loads `end`.

    The posture becomes the equilibrium. Raises EquilibriumError where the path ends or folds; the
    posture is then the last equilibrium.
    """
    path = _Path(mesh, work, begin, end, settings)
    negative = path.correct(0.0)
    if negative is None:
        raise EquilibriumError(
            "the present state is not near an equilibrium", 0.0, 0
        )
    path.negative = negative
    step = settings.first_step / FIRST_PROBE
    while path.factor < 1.0:
        if path.advance(min(1.0, path.factor + step)):
            step = max(
                GROWTH * step, settings.first_step if path.steps == 1 else 0.0
            )
            continue
        step /= 2
        if step < settings.least_step:
            raise EquilibriumError(
                "the branch ends or folds", path.factor, path.negative
            )
    return Equilibrium(
        path.branch(),
        path.negative,
        tuple(path.critical),
        path.steps,
        path.iterations,
    )
