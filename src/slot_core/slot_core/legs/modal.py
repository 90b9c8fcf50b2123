"""Statics of one leg in a dozen modes of its internal moment and axial force.

The potential energy over the coefficients c (`modal_basis.py`), in the leg's plane with the clamp
at the origin, x outward, z up, at tendon angle theta and clamp height h, is

    V = c.K c / 2 + k max(0, l.c - slack + r_spool theta)^2 / 2 + g int (dm/ds) z ds
        + sum_j k_j min(0, h + z(s_j))^2 / 2 - F.r(L) - M phi(L).

The tendon runs at the offset d below the centre line: l.c is the integral of eps up to its anchor
plus d (phi - phi_0) there. The floor has no friction and acts at the points s_j with the stiffness
k_j. A contact force at the tip leaves the moment smooth along the leg; one in between makes a kink
in it, for which the modes converge slowly.

Continuation follows the equilibria from the natural shape to the load, by Newton's method with
exact second derivatives; a step where it fails is halved. The path stays on the branch of minima of
V and ends where that branch ends.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.linalg.lapack import dposv

from slot_core.legs.leg_map import LegEquilibrium, NoEquilibriumError
from slot_core.legs.modal_basis import Contact, Modes, build_basis, integrals
from slot_core.robot import GRAVITY, Array, Robot

MODES = Modes()
GAUSS_POINTS = 16  # in each part
SHAPE_POINTS = 22  # of a shape

# Continuation. The first step is the whole load.
LEAST_STEP = 1e-6  # part of the load
GROWTH = 2.0  # of the step after a success
LARGEST_TURN = 0.3  # rad, of any section in one step
ITERATIONS = 12  # of Newton's method in one step, at most
TOLERANCE = 1e-11  # of Newton's last increment, rad and strain


class Standing(NamedTuple):
    """Equilibrium of a leg that carries a load on a clamp that is free to rise."""

    height: float  # m, of the clamp
    leg: LegEquilibrium


class Load(NamedTuple):
    """Loads and constraints of a leg."""

    angle: float  # rad, of the tendon
    height: float  # m, of the clamp if it is held
    carried: float  # N, vertical force of the floor if the clamp is free to rise
    gravity: float  # m/s^2
    force_x: float = 0.0  # N, at the tip
    force_z: float = 0.0
    moment: float = 0.0  # N m, at the tip

    def toward(self, other: Load, part: float) -> Load:
        """Linear interpolation: this load at part 0, the other at 1."""
        return Load(*((1.0 - part) * a + part * b for a, b in zip(self, other)))


class Derivatives(NamedTuple):
    """Derivatives of the energy over the n coefficients and, last, the clamp height."""

    gradient: Array  # (n + 1,)
    hessian: Array  # (n + 1, n + 1)


class ModalLeg:
    """One leg on a floor without friction, its clamp horizontal and either held or free to rise.

    robot: geometry, material and tendon. contact: points on which the floor acts. modes: of moment
    and axial force. A solution starts from the last one where that lies on the same path.

    Dynamics in these modes are slower than those of the chain. With 12 unknowns a step of four legs
    needs 7 to 10 us for products and factors of the dense mass matrices alone (two iterations):
    twice the whole step of the chain of 22 nodes, and as much as one of 61 nodes, whose third
    frequency is as accurate (0.3 %).
    """

    def __init__(self, robot: Robot, contact: Contact, modes: Modes = MODES):
        self.modes, self.basis = modes, build_basis(robot, modes, GAUSS_POINTS)
        self._tendon = robot.tendon
        self._nodes = self._rows(np.linspace(0.0, 1.0, SHAPE_POINTS))
        self._points = self._rows(np.array(contact.fraction))
        self._tip = self._rows(np.ones(1))[0]
        self._end_turn = self.basis.weight @ self.basis.curve
        self._stiffness = np.array(contact.stiffness)
        self.reset()

    def reset(self) -> None:
        """Reset to the natural shape, above the floor, without weight."""
        high = 2 * self.basis.edges[-1]  # m, above the reach of the leg
        self._state = np.append(np.zeros(self.modes.unknowns), high)
        self._load = Load(0.0, high, 0.0, 0.0)
        self._held = True

    def solve(self, angle: float, height: float) -> LegEquilibrium:
        """Equilibrium at a tendon angle (rad) and a clamp height (m).

        The path lowers the clamp at angle zero and then increases the angle. Raises
        NoEquilibriumError where it ends before.
        """
        if not self._on_path(held=True, value=height):
            self._lower(height)
        self._follow(self._load._replace(angle=angle), held=True)
        return self._equilibrium()

    def stand(self, angle: float, carried: float) -> Standing:
        """Equilibrium at a tendon angle (rad) with a vertical force `carried` (N) of the floor.

        The force includes the leg's own weight. The path applies the load at angle zero and then
        increases the angle. Raises ValueError for a load that is not positive and
        NoEquilibriumError where the path ends before.
        """
        if not carried > 0.0:
            raise ValueError(f"load {carried} N must be positive")
        if not self._on_path(held=False, value=carried):
            self._touch_down(carried)
        self._follow(self._load._replace(angle=angle), held=False)
        return Standing(float(self._state[-1]), self._equilibrium())

    def bend(self, force: tuple[float, float] = (0.0, 0.0), moment: float = 0.0) -> Array:
        """Shape (SHAPE_POINTS, 2), m, under a dead force (x, z; N) and a moment (N m) at the tip.

        Without floor and weight, at tendon angle zero. Raises NoEquilibriumError.
        """
        self.reset()
        end = self._load._replace(force_x=force[0], force_z=force[1], moment=moment)
        self._follow(end, held=True)
        return self.shape()

    def shape(self) -> Array:
        """(SHAPE_POINTS, 2) shape of the last equilibrium, m from the clamp, x and z.

        The points have equal distances of natural arc length.
        """
        cos, sin, ratio = self._sections()
        return np.column_stack([self._nodes @ (ratio * cos), self._nodes @ (ratio * sin)])

    def clamp_moment(self) -> float:
        """Moment of floor forces and weight about the clamp at the last equilibrium, N m."""
        b, (cos, _, ratio) = self.basis, self._sections()
        weight = self._load.gravity * b.weight * b.beyond
        return float((self._contact_force() @ self._points - weight) @ (ratio * cos))

    def cable_extension(self) -> float:
        """Extension of the cable at the last equilibrium, m; negative: slack."""
        return self._cable(self._state, self._load.angle)

    def frequencies(self) -> Array:
        """(n,) Hz, undamped natural frequencies at the last equilibrium, clamp held, ascending."""
        stiffness = self._derivatives(self._state, self._load).hessian[:-1, :-1]
        return np.sqrt(eigh(stiffness, self._mass_matrix(), eigvals_only=True)) / (2 * math.pi)

    def _mass_matrix(self) -> Array:
        """(n, n) int (dm/ds) dr/dc . dr/dc ds at the last equilibrium, kg m^2 per unit of c^2."""
        b, (cos, sin, ratio) = self.basis, self._sections()
        running = self._rows(b.arc / b.edges[-1])
        displacements = (
            running @ (cos[:, None] * b.stretch - (ratio * sin)[:, None] * b.turn),
            running @ (sin[:, None] * b.stretch + (ratio * cos)[:, None] * b.turn),
        )
        return np.asarray(sum((b.weight * b.density * d.T) @ d for d in displacements))

    def _rows(self, fraction: Array) -> Array:
        """(p, g) weights of int_0^s at fractions (p,) of the arc length."""
        edges = self.basis.edges
        return integrals(edges, GAUSS_POINTS, fraction * edges[-1])

    def _hang(self) -> None:
        """Equilibrium above the floor at angle zero under the leg's own weight."""
        self.reset()
        self._follow(self._load._replace(gravity=GRAVITY), held=True)
        _, sin, ratio = self._sections()
        touching = float(-(self._points @ (ratio * sin)).min())
        self._place(touching)

    def _place(self, height: float) -> None:
        """Change the clamp height of a leg above the floor."""
        self._state[-1] = height
        self._load = self._load._replace(height=height)

    def _lower(self, height: float) -> None:
        """Lower the clamp from above the floor to a height (m)."""
        self._hang()
        self._place(max(height, self._load.height))
        self._follow(self._load._replace(height=height), held=True)

    def _touch_down(self, carried: float) -> None:
        """Lower the clamp to a small floor force, release it and apply the force `carried` (N)."""
        self._hang()
        depth = carried / self._stiffness.max()
        self._follow(self._load._replace(height=self._load.height - depth), held=True)
        self._load = self._load._replace(carried=float(self._contact_force().sum()))
        self._follow(self._load._replace(carried=carried), held=False)

    def _on_path(self, held: bool, value: float) -> bool:
        """Whether the last equilibrium is on the path in the angle at this height or load."""
        load = self._load
        same = (load.height if held else load.carried) == value
        return self._held == held and same and load[3:] == (GRAVITY, 0.0, 0.0, 0.0)

    def _follow(self, end: Load, held: bool) -> None:
        """Follow the equilibria to another load; raises NoEquilibriumError if they end before."""
        begin, part, step = self._load, 0.0, 1.0
        self._held = held
        while part < 1.0 and begin != end:
            step = min(step, 1.0 - part)
            reached = 1.0 if step == 1.0 - part else part + step
            load = begin.toward(end, reached)
            found = self._correct(load)
            if found is None:
                step /= 2
                if step < LEAST_STEP:
                    raise NoEquilibriumError(self._end_of_branch(end))
                continue
            self._state, self._load = found, load
            part, step = reached, step * GROWTH

    def _correct(self, load: Load) -> Array | None:
        """Newton's method from the last equilibrium; None where it fails or turns too far."""
        free = self.modes.unknowns + (not self._held)
        state = self._state.copy()
        if self._held:
            state[-1] = load.height
        for _ in range(ITERATIONS):
            gradient, hessian = self._derivatives(state, load)
            _, change, failed = dposv(hessian[:free, :free], gradient[:free])
            if failed:
                return None
            state[:free] -= change
            if self._size(state - self._state) > LARGEST_TURN:
                return None
            if self._size(change) <= TOLERANCE:
                return state
        return None

    def _size(self, change: Array) -> float:
        """Largest change of an angle (rad) or a strain."""
        c = change[: self.modes.unknowns]
        return float(max(np.abs(self.basis.turn @ c).max(), np.abs(self.basis.stretch @ c).max()))

    def _sections(self) -> tuple[Array, Array, Array]:
        return self._of_sections(self._state)

    def _of_sections(self, state: Array) -> tuple[Array, Array, Array]:
        """(g,) cosine and sine of the angle, and stretch ratio 1 + eps, at the Gauss points."""
        angle = self.basis.natural + self.basis.turn @ state[:-1]
        return np.cos(angle), np.sin(angle), 1.0 + self.basis.stretch @ state[:-1]

    def _cable(self, state: Array, angle: float) -> float:
        """Extension of the cable, m; negative: slack."""
        tendon = self._tendon
        return float(self.basis.cable @ state[:-1]) - tendon.slack + tendon.spool_radius * angle

    def _derivatives(self, state: Array, load: Load) -> Derivatives:
        """Gradient and Hessian of the energy at a state (n + 1,)."""
        b, c, tendon = self.basis, state[:-1], self._tendon
        cos, sin, ratio = self._of_sections(state)
        contact = self._stiffness * np.maximum(0.0, -state[-1] - self._points @ (ratio * sin))
        cable = tendon.cable_stiffness * max(0.0, self._cable(state, load.angle))
        # Energy of dead loads and of the present contact forces: sum ratio (a sin + e cos).
        a = load.gravity * b.weight * b.beyond - contact @ self._points - load.force_z * self._tip
        e = -load.force_x * self._tip
        along, across = a * sin + e * cos, a * cos - e * sin
        gradient = np.empty(len(state))
        gradient[:-1] = b.elastic @ c + cable * b.cable - load.moment * self._end_turn
        gradient[:-1] += along @ b.stretch + (ratio * across) @ b.turn
        gradient[-1] = load.carried - contact.sum()
        mixed = (across * b.stretch.T) @ b.turn
        hessian = np.zeros((len(state), len(state)))
        hessian[:-1, :-1] = b.elastic + mixed + mixed.T - (ratio * along * b.turn.T) @ b.turn
        if cable > 0.0:
            hessian[:-1, :-1] += tendon.cable_stiffness * np.outer(b.cable, b.cable)
        touching = contact > 0.0
        if touching.any():
            rise = self._height_derivatives(touching, cos, sin, ratio)
            hessian += (self._stiffness[touching] * rise.T) @ rise
        return Derivatives(gradient, hessian)

    def _height_derivatives(self, points: Array, cos: Array, sin: Array, ratio: Array) -> Array:
        """(p, n + 1) derivatives of contact points' heights over coefficients and clamp height."""
        b, rows = self.basis, self._points[points]
        by_coefficients = (rows * sin) @ b.stretch + (rows * ratio * cos) @ b.turn
        return np.column_stack([by_coefficients, np.ones(len(rows))])

    def _contact_force(self) -> Array:
        """(p,) N, force of the floor at the contact points."""
        _, sin, ratio = self._sections()
        return self._stiffness * np.maximum(0.0, -self._state[-1] - self._points @ (ratio * sin))

    def _equilibrium(self) -> LegEquilibrium:
        """The last equilibrium; slope and stiffness hold while the same points touch the floor."""
        cos, _, ratio = self._sections()
        contact, x = self._contact_force(), self._points @ (ratio * cos)
        force = float(contact.sum())
        hessian = self._derivatives(self._state, self._load).hessian
        stretch = self.cable_extension()
        pull = self._tendon.cable_stiffness * (stretch > 0.0)
        by_height, by_angle = hessian[:-1, -1], pull * self._tendon.spool_radius * self.basis.cable
        _, response, _ = dposv(hessian[:-1, :-1], np.column_stack([by_angle, by_height]))
        slope, softening = by_height @ response
        centre = float(contact @ x) / force if force > 0.0 else float(self._tip @ (ratio * cos))
        return LegEquilibrium(
            force=force,
            slope=float(slope),
            stiffness=float(softening - hessian[-1, -1]),
            contact_x=centre,
            tension=max(0.0, pull * stretch),
            node=self.shape(),
        )

    def _end_of_branch(self, end: Load) -> str:
        last = self._load
        where = f"height {last.height:.4f} m" if self._held else f"load {last.carried:.4f} N"
        return (
            f"leg, path to {math.degrees(end.angle):.3f} deg: the branch ends; last"
            f" equilibrium at {math.degrees(last.angle):.3f} deg, {where}"
        )
