"""Spatial Cosserat rod: statics, natural frequencies and motion, independent of the robot.

    leg = Geometry(0.2, Rectangle(0.02, (8e-3, 4e-3)))
    rod = CosseratRod(Material(1e7, 3.3e6, 1200.0, 5e-4), leg)
    rod.solve_static(Loads(force=(0.0, 0.3, 1.0)))
    for _ in range(1000):
        rod.step(1e-3)

The rod stretches, bends in both planes and twists; it does not shear, and its sections have no
moment of inertia about their cross axes. It is the chain of the robot's legs
(`dynamics/rod.py`, `dynamics/spatial`), of fourth order in the length of a segment for bending in
one plane. Tangent and elimination are in `elimination.py`.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from slot_core.arrays import Array, checked
from slot_core.dynamics.rod import lumped
from slot_core.refusal import DivergenceError, quoted
from slot_core.rod import kernels
from slot_core.rod.mesh import build_mesh, frame_rows, place, work_space
from slot_core.rod.model import (
    CLAMPED,
    FREE,
    MIDPOINT,
    Energy,
    Geometry,
    Loads,
    Material,
    Plane,
    Pose,
    RodError,
    RodState,
    RodTendon,
    Scheme,
    Support,
    need,
    numbers,
)
from slot_core.rod.statics import (
    Equilibrium,
    EquilibriumError,
    RodLoads,
    StaticSettings,
    follow,
)

NO_LOADS = Loads()
ORIGIN = Pose()
STATICS = StaticSettings()


class CosseratRod:
    """Spatial geometrically exact rod with stretch, bending and twist.

    nodes: number of nodes, at least 2.
    base, tip: supports of the ends.
    pose: of the base.
    refined: with the correction of the hinges where bending and twist meet, which makes the error
        of third order in any direction (`dynamics/spatial/strain.py`). Newton's method then needs
        more iterations; on a strip that is hundreds of times as stiff sideways it may fail.
    tendons: cables along it, whose pull or length `Loads` sets.
    planes: walls that it cannot enter; it begins outside of them.

    The rod starts at rest in its natural shape. A step allocates no memory.

    Raises RodError for invalid material, geometry, pose or number of nodes.
    """

    def __init__(  # noqa: PLR0917
        self,
        material: Material,
        geometry: Geometry,
        nodes: int = 31,
        base: Support = CLAMPED,
        tip: Support = FREE,
        pose: Pose = ORIGIN,
        scheme: Scheme = MIDPOINT,
        refined: bool = True,
        tendons: Sequence[RodTendon] = (),
        planes: Sequence[Plane] = (),
    ) -> None:
        self.mesh = build_mesh(
            material, geometry, nodes, base, tip, refined, tendons, planes
        )
        self.scheme = scheme
        self.time = 0.0  # s
        self._work = work_space(self.mesh)
        axes = Rotation.from_rotvec(pose.rotation).as_matrix()
        place(self.mesh, self._work, np.asarray(pose.position), axes)
        self._target = np.zeros((2, 4, 3))
        self._loads: Loads | None = None
        self._load = RodLoads(
            np.zeros((nodes, 3)),
            np.zeros(3),
            np.zeros(3),
            np.zeros((len(tendons), 3)),
        )
        self._no_record = np.zeros((0, 3))
        self._rest()

    @property
    def nodes(self) -> int:
        """Number of nodes."""
        return len(self.mesh.rod.mass)

    @property
    def unconverged(self) -> int:
        """Steps so far whose last Newton increment was above the scheme's tolerance."""
        return int(self._work.unconverged[0])

    @property
    def mass(self) -> float:
        """Mass, kg."""
        return float(self.mesh.rod.mass.sum())

    @property
    def tip(self) -> Pose:
        """Pose of the tip's section."""
        turn = Rotation.from_matrix(
            frame_rows(self._work.frame[1].T).T
        ).as_rotvec()
        return Pose(tuple(self._work.node[self.nodes - 1]), tuple(turn))

    @property
    def tendons(self) -> Array:
        """(m, 2) pull (N) and length (m) of each tendon at rest, in the present state and loads."""
        kernels.pose(self.mesh, self._work, self._load)
        return self._work.pull[:, [0, 2]].copy()

    @property
    def state(self) -> RodState:
        """A copy of the state."""
        work, n = self._work, self.nodes
        return RodState(
            position=work.node[:n].copy(),
            director=work.director[: n - 1].copy(),
            velocity=work.velocity[:n].copy(),
            swirl=work.swirl[: n - 1].copy(),
            ends=np.array([frame_rows(f.T).T for f in work.frame]),
        )

    @state.setter
    def state(self, state: RodState) -> None:
        """Set the state; raises RodError, and changes nothing, for a wrong shape or value."""
        work, n = self._work, self.nodes
        given = {
            name: checked(name, getattr(state, name), own.shape, error=RodError)
            for name, own in vars(self.state).items()
        }
        work.node[:n], work.velocity[:n] = given["position"], given["velocity"]
        work.director[: n - 1], work.swirl[: n - 1] = (
            given["director"],
            given["swirl"],
        )
        for frame, axes in zip(work.frame, given["ends"]):
            frame[:] = frame_rows(axes)
        work.turning[:] = 0.0
        work.driven[:] = work.velocity[[0, n - 1]]
        self._apply(NO_LOADS)
        self._rest()

    def step(
        self,
        h: float,
        loads: Loads = NO_LOADS,
        base: Pose | None = None,
        tip: Pose | None = None,
    ) -> None:
        """Advance the motion by h (s) under loads.

        base, tip: poses that the held components of the ends reach at the end of the step, at a
        constant rate. Without a pose they stay in place.

        Raises DivergenceError, and RodError for a step that is not finite and above 0.
        """
        _need_step(h)
        for end, pose in ((0, base), (1, tip)):
            if pose is not None:
                axes = Rotation.from_rotvec(pose.rotation).as_matrix()
                self._target[end, 0] = pose.position
                self._target[end, 1:] = frame_rows(axes)
        self._run(h, 1, loads, self._no_record)

    def run(
        self, h: float, steps: int, loads: Loads = NO_LOADS, samples: int = 0
    ) -> Array:
        """Advance by `steps` equal steps of h (s) with the supports at rest, in a compiled loop.

        Returns (samples, 3) positions of the tip at evenly spaced times, the last at the end.

        Raises RodError for a negative number or where `samples` does not divide `steps`, and the
        errors of `step`.
        """
        whole = all(
            isinstance(number, (int, np.integer)) for number in (steps, samples)
        )
        if (
            not whole
            or min(steps, samples) < 0
            or (samples and steps % samples)
        ):
            raise RodError(
                f"samples {samples} must divide steps {steps}, integers of 0 or more"
            )
        _need_step(h)
        record = np.zeros((samples, 3))
        self._run(h, steps, loads, record)
        return record

    def solve_static(
        self, loads: Loads = NO_LOADS, settings: StaticSettings = STATICS
    ) -> Equilibrium:
        """Move the rod to its equilibrium under loads, by continuation from the present loads.

        The last step or equilibrium has set the present loads; they are zero at first and after the
        state was set. The rod must be near an equilibrium under them.

        Raises EquilibriumError with the last load factor that was reached; the rod is then in that
        equilibrium. Raises RodError for `stay_stable` with a moment or a follower force, which have
        no potential to descend.
        """
        if settings.stay_stable and _has_no_potential(loads):
            raise RodError(
                "stay_stable needs loads with a potential: no moment, no follower force"
            )
        begin = RodLoads(*(part.copy() for part in self._load))
        self._apply(loads)
        end = RodLoads(*(part.copy() for part in self._load))
        kernels.pose(self.mesh, self._work, begin)
        # a length is given by and by, from the present one; what is not given any more stays
        for loose, present in (
            (begin, self._work.pull[:, 2]),
            (end, begin.tendon[:, 1]),
        ):
            free = loose.tendon[:, 2] == 0.0
            loose.tendon[free, 1] = present[free]
        reached = 1.0
        try:
            return follow(self.mesh, self._work, begin, end, settings)
        except EquilibriumError as error:
            reached = error.load_factor
            raise
        finally:
            kernels.settle(self._work)
            self._rest()
            self._set(
                begin.toward(end, reached), loads if reached == 1.0 else None
            )

    def energy(self, loads: Loads = NO_LOADS) -> Energy:
        """Kinetic, elastic and potential energy of the present state under loads, J (`Energy`)."""
        mesh, work, n = self.mesh, self._work, self.nodes
        v, spin = work.velocity[:n], work.swirl[: n - 1]
        kinetic = mesh.rod.mass @ (v**2).sum(axis=1) + mesh.rod.spin[:-1] @ (
            spin**2
        ).sum(axis=1)
        kinetic -= mesh.rod.coupling[:-1] @ (np.diff(v, axis=0) ** 2).sum(
            axis=1
        )
        nodal = self._nodal(loads)
        kernels.pose(mesh, work, nodal)
        return Energy(
            kinetic=float(kinetic / 2),
            elastic=float(kernels.elastic_energy(mesh, work)),
            potential=-float((nodal.dead * work.node[:n]).sum()),
        )

    def momentum(self) -> tuple[Array, Array]:
        """Linear momentum (3,), N s, and angular momentum about the origin (3,), N m s."""
        mesh, work, n = self.mesh, self._work, self.nodes
        r, v = work.node[:n], work.velocity[:n]
        p, less = (
            mesh.rod.mass[:, None] * v,
            mesh.rod.coupling[:-1, None] * np.diff(v, axis=0),
        )
        angular = np.cross(r, p).sum(axis=0) - np.cross(
            np.diff(r, axis=0), less
        ).sum(axis=0)
        angular += mesh.rod.spin[:-1] @ work.swirl[: n - 1]
        return p.sum(axis=0), angular

    def tangent(self, loads: Loads = NO_LOADS) -> Array:
        """(4 N + 7, 4 N + 7) tangent stiffness over the unknowns of `elimination.py`, held included.

        Antisymmetric parts that vanish in equilibrium are left out.
        """
        nodal = self._nodal(loads)
        kernels.pose(self.mesh, self._work, nodal)
        matrix = np.zeros((len(self.mesh.metric), len(self.mesh.metric)))
        kernels.dense(self.mesh, self._work, nodal, matrix)
        return matrix

    def mass_matrix(self) -> Array:
        """(4 N + 7, 4 N + 7) mass matrix over the unknowns of `tangent`; sections have no mass."""
        mesh, n = self.mesh, self.nodes
        matrix = np.zeros((len(mesh.metric), len(mesh.metric)))
        for c in range(3):
            at = 4 * np.arange(n) + 4 + c
            matrix[at, at] = mesh.rod.mass
            matrix[at[1:], at[1:]] -= mesh.rod.coupling[:-1]
            matrix[at[:-1], at[:-1]] -= mesh.rod.coupling[:-1]
            matrix[at[1:], at[:-1]] = matrix[at[:-1], at[1:]] = (
                mesh.rod.coupling[:-1]
            )
        at = 4 * np.arange(n - 1) + 7
        matrix[at, at] = mesh.rod.spin[:-1]
        return matrix

    def natural_frequencies(self, count: int, loads: Loads = NO_LOADS) -> Array:
        """Lowest undamped natural frequencies (count,), Hz, about the present state at rest.

        Solves K x = (2 pi f)^2 M x on the free unknowns. In an unstable state the growth rates over
        2 pi come first, with a negative sign.

        Raises RodError for a moment or a follower force, whose K is not symmetric; use `tangent`
        and `mass_matrix` there.
        """
        if _has_no_potential(loads):
            raise RodError(
                "natural frequencies need loads with a potential: no moment, no follower"
            )
        free = np.flatnonzero(self.mesh.free)
        square = np.ix_(free, free)
        stiffness, mass = (
            self.tangent(loads)[square],
            self.mass_matrix()[square],
        )
        metric = np.diag(self.mesh.metric[free])
        # M x = mu (K + a M) x: the lowest frequencies have the largest mu, which are the most
        # accurate, and turns without inertia are allowed.
        shift = 1e-3 * stiffness.trace() / metric.trace() / len(free) ** 3
        while True:
            try:
                values = eigh(
                    mass,
                    stiffness + shift * (mass + 1e-9 * metric),
                    eigvals_only=True,
                )
                break
            except np.linalg.LinAlgError:
                shift *= 10
        found = np.sort(1 / values[::-1][:count] - shift)
        return np.sign(found) * np.sqrt(np.abs(found)) / (2 * math.pi)

    def _rest(self) -> None:
        """Let the supports stay where they are; the axial forces follow from the strains."""
        kernels.pose(self.mesh, self._work, self._load)
        for end, node in ((0, 0), (1, self.nodes - 1)):
            self._target[end, 0] = self._work.node[node]
            self._target[end, 1:] = self._work.frame[end]

    def _run(self, h: float, steps: int, loads: Loads, record: Array) -> None:
        self._apply(loads)
        scheme = self.scheme
        settings = (scheme.theta, scheme.iterations, scheme.tolerance)
        done = kernels.run(
            self.mesh,
            self._work,
            self._load,
            self._target,
            h,
            settings,
            steps,
            record,
        )
        self.time += h * done
        if done < steps:
            # node with the largest last increment, of its place or of the segment behind
            change = np.abs(self._work.change[4:-3].reshape(-1, 4))
            fastest = np.nan_to_num(change, nan=np.inf).max(axis=1).argmax()
            raise DivergenceError(
                f"diverged after t = {self.time:g} s in step {done + 1} of {steps} "
                f"(h = {h:g} s), largest change at node {fastest}"
            )

    def _apply(self, loads: Loads) -> None:
        """Set the present loads, unless they are set already."""
        if loads is not self._loads:
            self._set(self._nodal(loads), loads)

    def _nodal(self, loads: Loads) -> RodLoads:
        """Loads at the nodes, and of the tendons."""
        mesh = self.mesh
        dead = mesh.rod.mass[:, None] * np.asarray(
            loads.gravity, dtype=np.float64
        )
        line = numbers("line", loads.line, dead.shape)
        dead += lumped(line, np.full((1, 1), mesh.refinement.step))
        dead[-1] += loads.force
        stiffness = mesh.cables.stiffness
        tendon = np.zeros((len(stiffness), 3))
        for column, name in enumerate(("pull", "length")):
            given = getattr(loads, name)
            if given is not None:
                found = checked(name, given, stiffness.shape, error=RodError)
                need(
                    bool((found >= 0.0).all()),
                    f"{name} {given} must not be below 0",
                )
                tendon[:, column] = found
        if loads.length is not None:
            need(
                bool(stiffness.any()),
                "length needs a tendon's stiffness above 0",
            )
            tendon[:, 2] = stiffness
        return RodLoads(
            dead,
            np.array(loads.moment, float),
            np.array(loads.follower, float),
            tendon,
        )

    def _set(self, nodal: RodLoads, loads: Loads | None) -> None:
        """Set the present loads from nodal loads."""
        for own, part in zip(self._load, nodal):
            own[:] = part
        self._loads = loads


def _need_step(h: float) -> None:
    """Raise RodError for a step (s) that is not finite and above 0."""
    is_number = isinstance(h, (int, float, np.number))
    need(
        is_number and 0.0 < h < math.inf,
        f"step {quoted(h)} must be above 0 and finite",
    )


def _has_no_potential(loads: Loads) -> bool:
    return any(loads.moment) or any(loads.follower)
