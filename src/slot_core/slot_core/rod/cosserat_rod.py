"""Planar Cosserat rod: statics, natural frequencies and motion, independent of the robot.

    leg = Geometry(0.2, Rectangle(0.02, (8e-3, 4e-3)))
    rod = CosseratRod(Material(1e7, 4e6, 1200.0, 5e-4), leg)
    rod.solve_static(Loads(force=(0.0, 1.0)))
    for _ in range(1000):
        rod.step(1e-3)

The elements are quadratic, with two Gauss points and lumped masses; the error falls with the fourth
power of the element size. Elements, tangent and elimination are in `kernels.py`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from slot_core.robot import Array
from slot_core.rod import kernels
from slot_core.rod.model import (
    CLAMPED,
    FREE,
    Geometry,
    Loads,
    Material,
    RodError,
    Support,
    build_mesh,
)
from slot_core.rod.statics import Equilibrium, EquilibriumError, RodLoads, StaticSettings, follow

NO_LOADS = Loads()
STATICS = StaticSettings()


class DivergenceError(ArithmeticError):
    """The motion diverged: the last Newton increment is not finite or above 1 rad or rod length."""


@dataclass(frozen=True)
class Scheme:
    """Theta time integration: forces are evaluated at t + theta h.

    theta = 1/2 is the implicit midpoint rule. It is of second order and conserves linear and
    angular momentum up to `tolerance`. It does not conserve energy: where the step resolves the
    motion, the energy oscillates about its initial value. Above 1/2 the scheme is of first order
    and damps motion that the step does not resolve.

    Raises RodError for theta outside of 0.5 .. 1 or fewer than one iteration.
    """

    theta: float = 0.5
    iterations: int = 20  # of Newton's method, at most
    tolerance: float = 1e-9  # of Newton's last increment, in rad and rod lengths

    def __post_init__(self) -> None:
        if not 0.5 <= self.theta <= 1.0:
            raise RodError(f"theta {self.theta} must be within 0.5 .. 1")
        if self.iterations < 1:
            raise RodError(f"iterations {self.iterations} must be at least 1")


MIDPOINT = Scheme()


@dataclass(frozen=True)
class RodState:
    """Poses (n, 3), m, m, rad, and velocities (n, 3), m/s, m/s, rad/s, of the nodes."""

    pose: Array
    velocity: Array


@dataclass(frozen=True)
class Energy:
    """Energies, J. The potential is that of gravity and dead loads, zero at the origin."""

    kinetic: float
    elastic: float
    potential: float

    @property
    def total(self) -> float:
        """Sum of the three, J."""
        return self.kinetic + self.elastic + self.potential


class CosseratRod:
    """Planar geometrically exact rod with stretch, bending and, optionally, shear.

    elements: number of elements, at least 1; the rod has 2 elements + 1 nodes.
    base, tip: supports of the ends.
    pose: (x, y, angle) of the base, m, m, rad.
    shear, rotary_inertia: whether the sections shear and have a moment of inertia.

    The rod starts at rest in its natural shape. A step allocates no memory.

    Raises RodError for invalid material, geometry or number of elements.
    """

    def __init__(  # noqa: PLR0917
        self,
        material: Material,
        geometry: Geometry,
        elements: int = 15,
        base: Support = CLAMPED,
        tip: Support = FREE,
        pose: tuple[float, float, float] = (0.0, 0.0, 0.0),
        shear: bool = True,
        rotary_inertia: bool = True,
        scheme: Scheme = MIDPOINT,
    ) -> None:
        self.mesh = build_mesh(material, geometry, elements, base, tip, shear, rotary_inertia)
        self.mesh.natural[:] = _moved(self.mesh.natural, pose)
        self.scheme = scheme
        self.time = 0.0  # s
        self._work = kernels.work_space(self.mesh)
        self._target = self._work.pose[[0, -1]].copy()
        self._loads: Loads | None = None
        self._load, self._follower = np.zeros_like(self.mesh.natural), np.zeros(2)
        self._no_record = np.zeros((0, 3))

    @property
    def nodes(self) -> int:
        """Number of nodes, 2 elements + 1."""
        return len(self.mesh.natural)

    @property
    def unconverged(self) -> int:
        """Steps so far whose last Newton increment was above the scheme's tolerance."""
        return int(self._work.unconverged[0])

    @property
    def mass(self) -> Array:
        """(n, 3) lumped masses of the nodes, kg, kg, kg m^2."""
        return self.mesh.mass.copy()

    @property
    def state(self) -> RodState:
        """A copy of poses and velocities."""
        return RodState(self._work.pose.copy(), self._work.velocity.copy())

    @state.setter
    def state(self, state: RodState) -> None:
        for own, given in ((self._work.pose, state.pose), (self._work.velocity, state.velocity)):
            if np.shape(given) != own.shape:
                raise RodError(f"state of shape {np.shape(given)} must have {own.shape}")
            if not np.all(np.isfinite(given)):
                raise RodError("state must be finite")
            own[:] = given
        self._work.stage[:] = self._work.pose
        kernels.stress_of(self.mesh, self._work)
        self._apply(NO_LOADS)
        self._target[:] = self._work.pose[[0, -1]]

    def step(
        self,
        h: float,
        loads: Loads = NO_LOADS,
        base: tuple[float, float, float] | None = None,
        tip: tuple[float, float, float] | None = None,
    ) -> None:
        """Advance the motion by h (s) under loads.

        base, tip: poses (x, y, angle), m, m, rad, that the supported components of the ends reach
        at the end of the step, at a constant rate. Without a pose they stay in place.

        Raises DivergenceError, and RodError for a step, load or pose that is not finite or for a
        step that is not above 0.
        """
        for end, pose in ((0, base), (1, tip)):
            if pose is not None:
                if not all(math.isfinite(part) for part in pose):
                    raise RodError(f"pose {pose} must be finite")
                self._target[end] = pose
        self._run(h, 1, loads, self._no_record)

    def run(self, h: float, steps: int, loads: Loads = NO_LOADS, samples: int = 0) -> Array:
        """Advance by `steps` equal steps of h (s) with the supports at rest, in a compiled loop.

        Returns (samples, 3) poses of the tip at evenly spaced times, the last at the end.

        Raises RodError where `samples` does not divide `steps`, and the errors of `step`.
        """
        if samples and steps % samples:
            raise RodError(f"samples {samples} must divide steps {steps}")
        record = np.zeros((samples, 3))
        self._run(h, steps, loads, record)
        return record

    def solve_static(
        self, loads: Loads = NO_LOADS, settings: StaticSettings = STATICS
    ) -> Equilibrium:
        """Move the rod to its equilibrium under loads, by continuation from the present loads.

        The present loads are those of the last step or equilibrium; they are zero at first and
        after the state was set. The rod must be near an equilibrium under them.

        Raises EquilibriumError with the last load factor that was reached; the rod is then in that
        equilibrium. Raises RodError for `stay_stable` with a follower force, which has no potential
        to descend.
        """
        if settings.stay_stable and any(loads.follower):
            raise RodError("stay_stable needs loads with a potential, not a follower force")
        work, begin = self._work, RodLoads(self._load.copy(), self._follower.copy())
        self._apply(loads)
        end = RodLoads(self._load.copy(), self._follower.copy())
        work.stage[:] = work.pose
        reached = 1.0
        try:
            return follow(self.mesh, work, begin, end, settings)
        except EquilibriumError as error:
            reached = error.load_factor
            raise
        finally:
            work.pose[:] = work.stage
            work.velocity[:] = 0.0
            self._target[:] = work.pose[[0, -1]]
            self._set(begin.toward(end, reached), loads if reached == 1.0 else None)

    def energy(self, loads: Loads = NO_LOADS) -> Energy:
        """Kinetic, elastic and potential energy of the present state under loads, J."""
        pose, velocity = self._work.pose, self._work.velocity
        return Energy(
            kinetic=float((self.mesh.mass * velocity**2).sum() / 2),
            elastic=float(kernels.elastic_energy(self.mesh, pose)),
            potential=-float((self._nodal(loads).dead * pose).sum()),
        )

    def momentum(self) -> tuple[float, float, float]:
        """Linear momentum x, y (N s) and angular momentum about the origin (N m s)."""
        p = self.mesh.mass * self._work.velocity
        q = self._work.pose
        angular = q[:, 0] @ p[:, 1] - q[:, 1] @ p[:, 0] + p[:, 2].sum()
        return float(p[:, 0].sum()), float(p[:, 1].sum()), float(angular)

    def tangent(self, loads: Loads = NO_LOADS) -> Array:
        """(3 n, 3 n) tangent stiffness over the nodes' x, y, angle, supported ones included."""
        self._work.stage[:] = self._work.pose
        kernels.stress_of(self.mesh, self._work)
        matrix = np.zeros((3 * self.nodes, 3 * self.nodes))
        kernels.dense(self.mesh, self._work, *self._nodal(loads), matrix)
        return matrix

    def free_unknowns(self) -> NDArray[np.intp]:
        """Indices of the unknowns that no support prescribes."""
        held = np.zeros((self.nodes, 3), dtype=bool)
        held[[0, -1]] = self.mesh.held
        return np.flatnonzero(~held.ravel())

    def natural_frequencies(self, count: int, loads: Loads = NO_LOADS) -> Array:
        """Lowest undamped natural frequencies (count,), Hz, about the present poses.

        Solves K x = (2 pi f)^2 M x on the free unknowns. In an unstable state the growth rates over
        2 pi come first, with a negative sign.

        Raises RodError for a follower force, whose K is not symmetric; use `tangent` there.
        """
        if any(loads.follower):
            raise RodError("natural frequencies need loads with a potential, not a follower force")
        free = self.free_unknowns()
        stiffness = self.tangent(loads)[np.ix_(free, free)]
        mass = np.diag(self.mesh.mass.ravel()[free])
        metric = np.diag(self.mesh.metric.ravel()[free])
        # M x = mu (K + a M) x: the lowest frequencies have the largest mu, which are the most
        # accurate, and angles without inertia are allowed.
        shift = 1e-3 * stiffness.trace() / metric.trace() / len(free) ** 3
        while True:
            try:
                values = eigh(mass, stiffness + shift * (mass + 1e-9 * metric), eigvals_only=True)
                break
            except np.linalg.LinAlgError:
                shift *= 10
        square = np.sort(1 / values[::-1][:count] - shift)
        return np.sign(square) * np.sqrt(np.abs(square)) / (2 * math.pi)

    def _run(self, h: float, steps: int, loads: Loads, record: Array) -> None:
        if not 0.0 < h < math.inf:
            raise RodError(f"step {h} must be above 0 and finite")
        self._apply(loads)
        scheme = self.scheme
        done = kernels.run(
            self.mesh, self._work, self._load, self._follower, self._target, h,
            scheme.theta, scheme.iterations, scheme.tolerance, steps, record,
        )  # fmt: skip
        self.time += h * done
        if done < steps:
            change = np.abs(self._work.change)
            node = int(np.nan_to_num(change, nan=np.inf).max(axis=1).argmax())
            raise DivergenceError(
                f"diverged after t = {self.time:g} s in step {done + 1} of {steps} "
                f"(h = {h:g} s), largest change at node {node}"
            )

    def _apply(self, loads: Loads) -> None:
        """Set the present loads, unless they are set already."""
        if loads is not self._loads:
            self._set(self._nodal(loads), loads)

    def _nodal(self, loads: Loads) -> RodLoads:
        """Loads at the nodes; raises RodError for a load that is not finite."""
        values = (*loads.gravity, *loads.force, loads.moment, *loads.follower)
        if not all(math.isfinite(value) for value in values):
            raise RodError(f"{loads} must be finite")
        dead = np.zeros_like(self._load)
        dead[:, :2] = self.mesh.mass[:, :1] * np.asarray(loads.gravity)
        dead[-1] += (*loads.force, loads.moment)
        return RodLoads(dead, np.asarray(loads.follower, dtype=np.float64))

    def _set(self, nodal: RodLoads, loads: Loads | None) -> None:
        """Set the present loads from nodal loads."""
        self._load[:], self._follower[:] = nodal
        self._loads = loads


def _moved(shape: Array, pose: tuple[float, float, float]) -> Array:
    """Shape (n, 3), given from the origin along x, moved to a pose (x, y, angle)."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    turned = shape[:, :2] @ np.array([[c, s], [-s, c]])
    return np.column_stack([turned + pose[:2], shape[:, 2] + pose[2]])
