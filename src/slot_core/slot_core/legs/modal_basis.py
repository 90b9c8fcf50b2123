"""Modes of a leg's internal moment and axial force, and the contact points of the floor.

The modes are Legendre polynomials P_j over each of the two parts of the leg, from the clamp to the
tendon's anchor and from there to the tip. With the arc length s of the natural shape and its angle
phi_0(s):

    phi = phi_0 + int_0^s sum_j m_j P_j / (E I) ds,     eps = sum_j n_j P_j / (E A),
    r   = int_0^s (1 + eps) (cos phi, sin phi) ds.

The parts meet at the anchor because moment and axial force jump there; modes across it would
converge slowly. In a part all integrals are sums over Gauss points: a function is replaced by its
Legendre interpolant, whose integral is int_{-1}^t P_j = (P_{j+1}(t) - P_{j-1}(t)) / (2 j + 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.polynomial.legendre import leggauss, legvander

from slot_core.robot import Array, Leg, Robot


@dataclass(frozen=True)
class Modes:
    """Numbers of Legendre polynomials, from P_0 on, before and behind the tendon's anchor.

    Raises ValueError for a negative number or a part without a moment.
    """

    moment: tuple[int, int] = (4, 4)
    axial: tuple[int, int] = (2, 2)

    def __post_init__(self) -> None:
        if min(*self.moment, *self.axial) < 0 or min(self.moment) < 1:
            raise ValueError(f"{self}: each part needs a moment, and no number may be negative")

    @property
    def unknowns(self) -> int:
        """Number of coefficients."""
        return sum(self.moment) + sum(self.axial)


@dataclass(frozen=True)
class Contact:
    """Points of the leg on which the floor acts.

    Raises ValueError unless there is a point and every fraction and stiffness is in its range.
    """

    fraction: tuple[float, ...]  # of the arc length, from the clamp
    stiffness: tuple[float, ...]  # N/m

    def __post_init__(self) -> None:
        if len(self.fraction) != len(self.stiffness) or not self.fraction:
            raise ValueError(f"{self}: as many stiffnesses as points are needed, at least one")
        if not (min(self.fraction) > 0.0 and max(self.fraction) <= 1.0):
            raise ValueError(f"{self}: points must be within 0 (excluded) .. 1 of the leg")
        if not min(self.stiffness) > 0.0:
            raise ValueError(f"{self}: stiffnesses must be positive")


def tip_contact(stiffness: float) -> Contact:
    """Contact at the tip alone, with a stiffness in N/m."""
    return Contact((1.0,), (stiffness,))


class Basis(NamedTuple):
    """Leg in n modes, at the g Gauss points of both parts; derivatives are per unit coefficient."""

    edges: Array  # (3,) m, clamp, anchor, tip
    arc: Array  # (g,) m, s
    weight: Array  # (g,) m, weights of int_0^L
    natural: Array  # (g,) rad, phi_0
    curve: Array  # (g, n) 1/m per coefficient (N m or N), curvature kappa
    turn: Array  # (g, n) rad per coefficient, angle phi
    stretch: Array  # (g, n) per coefficient, strain eps
    density: Array  # (g,) kg/m
    beyond: Array  # (g,) kg, mass from s to the tip
    elastic: Array  # (n, n) K, second derivatives of the elastic energy
    cable: Array  # (n,) l, m per coefficient, length of the tendon


def build_basis(robot: Robot, modes: Modes, points: int) -> Basis:
    """Modes of a robot's leg, with `points` Gauss points in each part.

    Raises ValueError where the tendon ends at the tip, so that no part is left behind its anchor.
    """
    if robot.tendon.end_fraction >= 1.0:
        raise ValueError(f"tendon.end_fraction {robot.tendon.end_fraction} must be below 1")
    leg, length = robot.leg, robot.leg.arc_length()
    edges = np.array([0.0, robot.tendon.end_fraction, 1.0]) * length
    t, w = leggauss(points)
    half = np.diff(edges)[:, None] / 2
    arc, weight = (edges[:-1, None] + half * (1 + t)).ravel(), (half * w).ravel()
    thickness = np.interp(arc, [0.0, length], [leg.thickness_clamp, leg.thickness_tip])
    axial = leg.young_modulus * leg.width * thickness
    bending = axial * thickness**2 / 12
    moments = _polynomials(t, modes.moment, (0, sum(modes.axial)))
    forces = _polynomials(t, modes.axial, (sum(modes.moment), 0))
    curve, stretch = moments / bending[:, None], forces / axial[:, None]
    running = integrals(edges, points, arc)
    density = leg.density * leg.width * thickness
    covered = integrals(edges, points, edges[1:2])[0]
    return Basis(
        edges=edges,
        arc=arc,
        weight=weight,
        natural=_natural_angle(leg, arc),
        curve=curve,
        turn=running @ curve,
        stretch=stretch,
        density=density,
        beyond=weight @ density - running @ density,
        elastic=(weight * curve.T) @ moments + (weight * stretch.T) @ forces,
        cable=covered @ (stretch + robot.tendon.offset * curve),
    )


def integrals(edges: Array, points: int, arc: Array) -> Array:
    """(len(arc), g) weights of int_0^s over function values at the Gauss points, at s = arc (m).

    edges: ends of the parts, m. points: Gauss points in each part.
    """
    t, w = leggauss(points)
    order = np.arange(points)
    to_series = (order + 0.5)[:, None] * legvander(t, points - 1).T * w
    parts = []
    for begin, end in pairwise(edges):
        half = (end - begin) / 2
        at = legvander(np.clip((arc - begin) / half - 1, -1, 1), points)
        before = np.column_stack([-np.ones(len(arc)), at[:, : points - 1]])
        parts.append(half * (at[:, 1:] - before) / (2 * order + 1) @ to_series)
    return np.hstack(parts)


def _natural_angle(leg: Leg, arc: Array) -> Array:
    """Angle of the natural shape, rad, at arc lengths (m); Newton's method for s(x) = arc."""
    slope = leg.shape.deriv()
    x = arc / leg.arc_length() * leg.reach
    t, w = leggauss(64)
    for _ in range(50):
        inside = np.hypot(1.0, slope(x[:, None] * (1 + t) / 2))
        change = (x / 2 * (inside @ w) - arc) / np.hypot(1.0, slope(x))
        x = x - change
        if np.abs(change).max() <= 1e-15:  # m
            break
    angle: Array = np.arctan(slope(x))
    return angle


def _polynomials(t: Array, counts: tuple[int, int], margin: tuple[int, int]) -> Array:
    """(g, n) values of the polynomials of both parts, zero in the margins' columns."""
    first, second = (legvander(t, count)[:, :count] for count in counts)
    table = np.zeros((2 * len(t), margin[0] + sum(counts) + margin[1]))
    table[: len(t), margin[0] : margin[0] + counts[0]] = first
    begin = margin[0] + counts[0]
    table[len(t) :, begin : begin + counts[1]] = second
    return table
