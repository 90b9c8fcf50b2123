"""A leg in a dozen modes of its internal moment and axial force, for statics and maps.

Potential energy over the coefficients c (`modal_basis.py`), in the leg's plane with the clamp at
the origin, x outward, z up, at tendon angle theta and clamp height h:

    V = c.K c / 2 + k max(0, l.c - slack + r_spool theta)^2 / 2 + g int (dm/ds) z ds
        + sum_j k_j min(0, h + z(s_j))^2 / 2 - F.r(L) - M phi(L).

The tendon runs at the offset d below the centre line: l.c is the integral of eps up to its anchor,
plus d (phi - phi_0) there. The floor is without friction and pushes at the points s_j. Only the
tip's push is smooth along the leg; one in between gives the moment a kink, which modes follow
slowly.

Newton's method with the exact second derivatives follows the equilibria from the natural shape
along a load, by steps that are halved where it fails; it stays on the branch, on which V has a
minimum, and ends where that branch does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dposv

from slot_core.legs.leg_map import LegEquilibrium, NoEquilibriumError
from slot_core.legs.modal_basis import Contact, Modes, build_basis, integrals
from slot_core.robot import GRAVITY, Array, Robot

MODES = Modes()
GAUSS_POINTS = 16  # in each part


@dataclass(frozen=True)
class Continuation:
    """How equilibria are followed."""

    least_step: float = 1e-6  # of the load, of which the whole is tried first
    growth: float = 2.0
    largest_turn: float = 0.3  # rad, of any section in one step
    iterations: int = 12
    tolerance: float = 1e-11  # of Newton's increment, rad and strain


CONTINUATION = Continuation()


class Standing(NamedTuple):
    """A leg that carries a load."""

    height: float  # m, of the clamp
    leg: LegEquilibrium


class Load(NamedTuple):
    """What acts on the leg."""

    angle: float  # rad, of the tendon
    height: float  # m, of the clamp, where it is held
    carried: float  # N, by the floor, where it is not
    gravity: float  # m/s^2
    force_x: float = 0.0  # N, at the tip
    force_z: float = 0.0
    moment: float = 0.0  # N m, at the tip

    def toward(self, other: Load, part: float) -> Load:
        """The load between this and another one."""
        return Load(*((1.0 - part) * a + part * b for a, b in zip(self, other)))


class Derivatives(NamedTuple):
    """Derivatives of the energy over the coefficients and, last, the clamp's height."""

    gradient: Array  # (n + 1,)
    hessian: Array  # (n + 1, n + 1)


class ModalLeg:
    """One leg, its clamp horizontal and held or free to rise, on a floor without friction.

    Dynamics in these modes would not pay. With 12 unknowns a step of four legs needs 7 to 10 us for
    the products and factors of the dense mass matrices alone (two iterations), which is twice the
    whole step of the chain of 22 nodes and as much as one of 61 nodes, whose third frequency is as
    exact (0.3 %).
    """

    def __init__(
        self,
        robot: Robot,
        contact: Contact,
        modes: Modes = MODES,
        *,
        settings: Continuation = CONTINUATION,
        nodes: int = 22,
    ):
        """nodes: how many points of the shape an `LegEquilibrium` holds."""
        self.modes, self.basis = modes, build_basis(robot, modes, GAUSS_POINTS)
        self.settings, self._tendon = settings, robot.tendon
        self._nodes = self._rows(np.linspace(0.0, 1.0, nodes))
        self._points = self._rows(np.array(contact.fraction))
        self._tip = self._rows(np.ones(1))[0]
        self._end_turn = self.basis.weight @ self.basis.curve
        self._stiffness = np.array(contact.stiffness)
        self.reset()

    def reset(self) -> None:
        """Back to the natural shape, in the air, without weight."""
        high = 2 * self.basis.edges[-1]  # m, out of the floor's reach
        self._state = np.append(np.zeros(self.modes.unknowns), high)
        self._load = Load(0.0, high, 0.0, 0.0)
        self._held = True

    def solve(self, angle: float, height: float) -> LegEquilibrium:
        """LegEquilibrium at a tendon angle (rad) and a clamp height (m): lowered, then pulled.

        Raises NoEquilibriumError.
        """
        if not self._on_path(held=True, value=height):
            self._lower(height)
        self._follow(self._load._replace(angle=angle), held=True)
        return self._equilibrium()

    def stand(self, angle: float, carried: float) -> Standing:
        """Height (m) of a clamp that carries a load (N), at a tendon angle (rad).

        The load is what the floor carries, so the leg's own weight is in it. It is loaded at angle
        zero, then pulled. Raises NoEquilibriumError.
        """
        if not carried > 0.0:
            raise ValueError(f"load {carried} N must be positive")
        if not self._on_path(held=False, value=carried):
            self._touch_down(carried)
        self._follow(self._load._replace(angle=angle), held=False)
        return Standing(float(self._state[-1]), self._equilibrium())

    def bend(self, force: tuple[float, float] = (0.0, 0.0), moment: float = 0.0) -> Array:
        """Shape (nodes, 2), m, under a dead force (N) and a moment (N m) at the tip.

        In the air, without weight, at tendon angle zero. Raises NoEquilibriumError.
        """
        self.reset()
        end = self._load._replace(force_x=force[0], force_z=force[1], moment=moment)
        self._follow(end, held=True)
        return self.shape()

    def shape(self, points: int | None = None) -> Array:
        """(points, 2) m from the clamp, x and z, at equal arc lengths; of the last equilibrium."""
        rows = self._nodes if points is None else self._rows(np.linspace(0.0, 1.0, points))
        cos, sin, grow = self._sections()
        return np.column_stack([rows @ (grow * cos), rows @ (grow * sin)])

    def clamp_moment(self) -> float:
        """N m, of the floor and the leg's weight about the clamp, at the last equilibrium."""
        b, (cos, _, grow) = self.basis, self._sections()
        weight = self._load.gravity * b.weight * b.beyond
        return float((self._push() @ self._points - weight) @ (grow * cos))

    def cable_extension(self) -> float:
        """m, negative where the cable is slack, at the last equilibrium."""
        return self._cable(self._state, self._load.angle)

    def frequencies(self) -> Array:
        """(n,) Hz, all of them, undamped, about the last equilibrium at a held clamp, ascending."""
        stiffness = self._derivatives(self._state, self._load).hessian[:-1, :-1]
        return np.sqrt(eigh(stiffness, self.mass_matrix(), eigvals_only=True)) / (2 * math.pi)

    def mass_matrix(self) -> Array:
        """(n, n) int (dm/ds) dr/dc . dr/dc ds at the last equilibrium, kg m^2 over units of c^2."""
        b, (cos, sin, grow) = self.basis, self._sections()
        running = self._rows(b.arc / b.edges[-1])
        moves = (
            running @ (cos[:, None] * b.stretch - (grow * sin)[:, None] * b.turn),
            running @ (sin[:, None] * b.stretch + (grow * cos)[:, None] * b.turn),
        )
        mass: Array = sum((b.weight * b.density * move.T) @ move for move in moves)  # type: ignore[assignment]
        return mass

    def _rows(self, fraction: Array) -> Array:
        edges = self.basis.edges
        return integrals(edges, GAUSS_POINTS, fraction * edges[-1])

    def _hang(self) -> None:
        """In the air, at angle zero, by its own weight."""
        self.reset()
        self._follow(self._load._replace(gravity=GRAVITY), held=True)
        _, sin, grow = self._sections()
        touching = float(-(self._points @ (grow * sin)).min())
        self._place(touching)

    def _place(self, height: float) -> None:
        """Hold the clamp of a leg in the air at another height in the air."""
        self._state[-1] = height
        self._load = self._load._replace(height=height)

    def _lower(self, height: float) -> None:
        """Hang the leg and hold its clamp at a height."""
        self._hang()
        self._place(max(height, self._load.height))
        self._follow(self._load._replace(height=height), held=True)

    def _touch_down(self, carried: float) -> None:
        """Lower the leg until it carries a part of the load, and let go."""
        self._hang()
        dip = carried / self._stiffness.max()
        self._follow(self._load._replace(height=self._load.height - dip), held=True)
        self._load = self._load._replace(carried=float(self._push().sum()))
        self._follow(self._load._replace(carried=carried), held=False)

    def _on_path(self, held: bool, value: float) -> bool:
        """Whether the last equilibrium is on the path in the angle that is asked for."""
        load = self._load
        same = (load.height if held else load.carried) == value
        return self._held == held and same and load[3:] == (GRAVITY, 0.0, 0.0, 0.0)

    def _follow(self, end: Load, held: bool) -> None:
        """Go to another load; raises NoEquilibriumError at the last equilibrium before it."""
        begin, part, step = self._load, 0.0, 1.0
        self._held = held
        while part < 1.0 and begin != end:
            step = min(step, 1.0 - part)
            reached = 1.0 if step == 1.0 - part else part + step
            load = begin.toward(end, reached)
            found = self._correct(load)
            if found is None:
                step /= 2
                if step < self.settings.least_step:
                    raise NoEquilibriumError(self._end_of_branch(end))
                continue
            self._state, self._load = found, load
            part, step = reached, step * self.settings.growth

    def _correct(self, load: Load) -> Array | None:
        """Newton's method from the last equilibrium; None where it leaves its surroundings."""
        free = self.modes.unknowns + (not self._held)
        state = self._state.copy()
        if self._held:
            state[-1] = load.height
        for _ in range(self.settings.iterations):
            gradient, hessian = self._derivatives(state, load)
            _, change, failed = dposv(hessian[:free, :free], gradient[:free])
            if failed:
                return None
            state[:free] -= change
            if self._size(state - self._state) > self.settings.largest_turn:
                return None
            if self._size(change) <= self.settings.tolerance:
                return state
        return None

    def _size(self, change: Array) -> float:
        c = change[: self.modes.unknowns]
        return float(max(np.abs(self.basis.turn @ c).max(), np.abs(self.basis.stretch @ c).max()))

    def _sections(self) -> tuple[Array, Array, Array]:
        return self._of_sections(self._state)

    def _of_sections(self, state: Array) -> tuple[Array, Array, Array]:
        """Cosine and sine of the angle, 1 + eps, at the Gauss points."""
        angle = self.basis.natural + self.basis.turn @ state[:-1]
        return np.cos(angle), np.sin(angle), 1.0 + self.basis.stretch @ state[:-1]

    def _cable(self, state: Array, angle: float) -> float:
        """How far the tendon is longer than what the spool has left of it, m."""
        tendon = self._tendon
        return float(self.basis.cable @ state[:-1]) - tendon.slack + tendon.spool_radius * angle

    def _derivatives(self, state: Array, load: Load) -> Derivatives:
        b, c, tendon = self.basis, state[:-1], self._tendon
        cos, sin, grow = self._of_sections(state)
        push = self._stiffness * np.maximum(0.0, -state[-1] - self._points @ (grow * sin))
        cable = tendon.cable_stiffness * max(0.0, self._cable(state, load.angle))
        # The energy of dead loads and of the floor's present pushes: sum grow (a sin + e cos).
        a = load.gravity * b.weight * b.beyond - push @ self._points - load.force_z * self._tip
        e = -load.force_x * self._tip
        along, across = a * sin + e * cos, a * cos - e * sin
        gradient = np.empty(len(state))
        gradient[:-1] = b.elastic @ c + cable * b.cable - load.moment * self._end_turn
        gradient[:-1] += along @ b.stretch + (grow * across) @ b.turn
        gradient[-1] = load.carried - push.sum()
        mixed = (across * b.stretch.T) @ b.turn
        hessian = np.zeros((len(state), len(state)))
        hessian[:-1, :-1] = b.elastic + mixed + mixed.T - (grow * along * b.turn.T) @ b.turn
        if cable > 0.0:
            hessian[:-1, :-1] += tendon.cable_stiffness * np.outer(b.cable, b.cable)
        touching = push > 0.0
        if touching.any():
            rise = self._rise(touching, cos, sin, grow)
            hessian += (self._stiffness[touching] * rise.T) @ rise
        return Derivatives(gradient, hessian)

    def _rise(self, points: Array, cos: Array, sin: Array, grow: Array) -> Array:
        """(p, n + 1) gradient of the heights of contact points over coefficients and clamp."""
        b, rows = self.basis, self._points[points]
        moved = (rows * sin) @ b.stretch + (rows * grow * cos) @ b.turn
        return np.column_stack([moved, np.ones(len(rows))])

    def _push(self) -> Array:
        """(p,) N, of the floor at the contact points."""
        _, sin, grow = self._sections()
        return self._stiffness * np.maximum(0.0, -self._state[-1] - self._points @ (grow * sin))

    def _equilibrium(self) -> LegEquilibrium:
        """Of the last equilibrium; slope and stiffness while the same points touch the floor."""
        cos, _, grow = self._sections()
        push, x = self._push(), self._points @ (grow * cos)
        force = float(push.sum())
        hessian = self._derivatives(self._state, self._load).hessian
        stretch = self.cable_extension()
        pull = self._tendon.cable_stiffness * (stretch > 0.0)
        by_height, by_angle = hessian[:-1, -1], pull * self._tendon.spool_radius * self.basis.cable
        _, response, _ = dposv(hessian[:-1, :-1], np.column_stack([by_angle, by_height]))
        slope, give = by_height @ response
        centre = float(push @ x) / force if force > 0.0 else float(self._tip @ (grow * cos))
        return LegEquilibrium(
            force=force,
            slope=float(slope),
            stiffness=float(give - hessian[-1, -1]),
            contact_x=centre,
            tension=max(0.0, pull * stretch),
            node=self.shape(),
        )

    def _end_of_branch(self, end: Load) -> str:
        last = self._load
        where = f"height {last.height:.4f} m" if self._held else f"load {last.carried:.4f} N"
        return (
            f"leg on its way to {math.degrees(end.angle):.3f} deg: the branch ends; last"
            f" equilibrium at {math.degrees(last.angle):.3f} deg, {where}"
        )
