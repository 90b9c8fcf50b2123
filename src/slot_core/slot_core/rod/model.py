"""Description of a rod (material, section, supports, loads) and its quadratic elements.

The rod lies in the plane of x and y. It has the length L, its base at s = 0 and its tip at s = L,
and a support at each. E elements have 2 E + 1 nodes at equal distances of arc length. The pose of a
node is (x, y, angle), with the angle of the section's normal, which is the tangent where shear is
off.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

from slot_core.robot import Array

# Shear is switched off by a shear stiffness of 1e7 EI / L^2. The tip of a cantilever then moves by
# 3e-7 of its bending too far. A stiffer one leaves fewer digits in the pivots (1e8: four). It is
# damped like the other strains: without damping, single Newton iterations would excite its fast
# vibration.
RIGID_IN_SHEAR = 1e7

# Quadratic shape functions of nodes -1, 0, 1 at the Gauss points -1/sqrt(3), 1/sqrt(3), and their
# derivatives: two points integrate a quadratic element without locking and to fourth order.
GAUSS = 1.0 / math.sqrt(3.0)
SHAPE = np.array([[(x * x - x) / 2, 1 - x * x, (x * x + x) / 2] for x in (-GAUSS, GAUSS)])
SLOPE = np.array([[x - 0.5, -2 * x, x + 0.5] for x in (-GAUSS, GAUSS)])


class RodError(ValueError):
    """Invalid argument of a rod; the message names the quantity, its value and the limit."""


@dataclass(frozen=True)
class Material:
    """Kelvin-Voigt material: stress = modulus (strain + damping_time d(strain)/dt), all strains.

    Raises RodError for values that are not finite or not positive (damping_time: negative).
    """

    young_modulus: float  # Pa
    shear_modulus: float  # Pa; not used where shear is off
    density: float  # kg/m^3
    damping_time: float  # s

    def __post_init__(self) -> None:
        for name in ("young_modulus", "shear_modulus", "density"):
            _need(getattr(self, name) > 0.0, f"{name} {getattr(self, name)} must be above 0")
        _need(self.damping_time >= 0.0, f"damping_time {self.damping_time} must not be below 0")
        _need_finite(self.young_modulus, self.shear_modulus, self.density, self.damping_time)


class Section(Protocol):
    """Cross-section along the rod, over the fraction s / L."""

    @property
    def shear_factor(self) -> float:
        """Timoshenko's shear coefficient kappa: shear force = kappa G A times shear strain."""

    def area(self, fraction: Array) -> Array:
        """Area, m^2."""

    def second_moment(self, fraction: Array) -> Array:
        """Second moment of area for bending in the plane, m^4."""


@dataclass(frozen=True)
class Rectangle:
    """Rectangle: constant width across the plane, thickness linear from base to tip.

    Raises RodError for dimensions that are not positive and finite.
    """

    width: float  # m
    thickness: tuple[float, float]  # m, at base and tip
    shear_factor: float = 5 / 6

    def __post_init__(self) -> None:
        _need(self.width > 0.0, f"width {self.width} must be above 0")
        _need(min(self.thickness) > 0.0, f"thickness {self.thickness} must be above 0")
        _need_finite(self.width, *self.thickness)

    def area(self, fraction: Array) -> Array:
        """Area, m^2."""
        return self.width * self._thickness(fraction)

    def second_moment(self, fraction: Array) -> Array:
        """Second moment of area, m^4."""
        return self.width * self._thickness(fraction) ** 3 / 12

    def _thickness(self, fraction: Array) -> Array:
        return self.thickness[0] + (self.thickness[1] - self.thickness[0]) * fraction


@dataclass(frozen=True)
class Circle:
    """Solid circle, diameter linear from base to tip.

    Raises RodError for diameters that are not positive and finite.
    """

    diameter: tuple[float, float]  # m, at base and tip
    shear_factor: float = 0.9

    def __post_init__(self) -> None:
        _need(min(self.diameter) > 0.0, f"diameter {self.diameter} must be above 0")
        _need_finite(*self.diameter)

    def area(self, fraction: Array) -> Array:
        """Area, m^2."""
        return math.pi / 4 * self._diameter(fraction) ** 2

    def second_moment(self, fraction: Array) -> Array:
        """Second moment of area, m^4."""
        return math.pi / 64 * self._diameter(fraction) ** 4

    def _diameter(self, fraction: Array) -> Array:
        return self.diameter[0] + (self.diameter[1] - self.diameter[0]) * fraction


@dataclass(frozen=True)
class Geometry:
    """Length, section and natural curvature of a rod.

    curvature: 1/m, a number or a function of s (m). Raises RodError for an invalid length.
    """

    length: float  # m
    section: Section
    curvature: float | Callable[[Array], Array] = 0.0

    def __post_init__(self) -> None:
        _need(self.length > 0.0, f"length {self.length} must be above 0")
        _need_finite(self.length)

    def natural_shape(self, nodes: int) -> Array:
        """(nodes, 3) stress-free poses, m, m, rad, from the origin along x.

        Integrates angle' = curvature and r' = (cos angle, sin angle) with Gauss's rule on each
        interval, and on parts of it for the angle at the Gauss points. The error is that of
        rounding where the curvature is smooth.
        """
        x, w = np.polynomial.legendre.leggauss(8)
        x, w = (x + 1) / 2, w / 2
        cell = self.length / (nodes - 1)
        start = np.arange(nodes - 1) * cell
        inner = start[:, None, None] + cell * x[:, None] * x  # points up to each point
        part = cell * x * (self._curvature(inner) @ w)
        whole = cell * (self._curvature(start[:, None] + cell * x) @ w)
        angle = np.concatenate([[0.0], np.cumsum(whole)])
        inside = angle[:-1, None] + part
        steps = cell * np.stack([np.cos(inside) @ w, np.sin(inside) @ w], axis=1)
        return np.column_stack([np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)]), angle])

    def _curvature(self, s: Array) -> Array:
        value = self.curvature(s) if callable(self.curvature) else self.curvature
        return np.broadcast_to(np.asarray(value, dtype=np.float64), s.shape)


@dataclass(frozen=True)
class Support:
    """Components of an end's pose that are prescribed."""

    x: bool
    y: bool
    angle: bool


CLAMPED = Support(x=True, y=True, angle=True)
PINNED = Support(x=True, y=True, angle=False)
FREE = Support(x=False, y=False, angle=False)
ROLLER = Support(x=False, y=True, angle=False)  # slides along x


@dataclass(frozen=True)
class Loads:
    """Dead loads, of fixed direction, and a follower force, which turns with the tip."""

    gravity: tuple[float, float] = (0.0, 0.0)  # m/s^2
    force: tuple[float, float] = (0.0, 0.0)  # N, at the tip
    moment: float = 0.0  # N m, at the tip
    follower: tuple[float, float] = (0.0, 0.0)  # N, at the tip: normal to its section, and along it


class Mesh(NamedTuple):
    """Numbers of a rod of E quadratic elements: n = 2 E + 1 nodes, two Gauss points an element.

    axial, shear and bending are the stiffnesses at the Gauss points times their weights w (m).
    """

    natural: Array  # (n, 3) stress-free poses
    strain: Array  # (E, 2, 3) natural strains R^T r' and angle'
    axial: Array  # (E, 2) EA w, N m
    shear: Array  # (E, 2) kappa GA w, N m
    bending: Array  # (E, 2) EI w, N m^3
    mass: Array  # (n, 3) kg, kg, kg m^2
    metric: Array  # (n, 3) mass with a positive rotary term: norm of the unknowns
    held: Array  # (2, 3) bool, prescribed components at base and tip
    slope: Array  # (2, 3) 1/m, derivatives of the shape functions with respect to s
    length: float  # m
    damping_time: float  # s


def build_mesh(  # noqa: PLR0917
    material: Material,
    geometry: Geometry,
    elements: int,
    base: Support,
    tip: Support,
    shear: bool,
    rotary_inertia: bool,
) -> Mesh:
    """Divide a rod into elements; raises RodError for fewer than one.

    Masses are lumped by Simpson's rule. It keeps the order of the elements, makes the mass matrix
    diagonal and gives the exact mass of a section whose area is quadratic in s.
    """
    _need(elements >= 1, f"elements {elements} must be at least 1")
    section, length = geometry.section, geometry.length
    size = length / elements
    point = (np.arange(elements)[:, None] + (1 + np.array([-GAUSS, GAUSS])) / 2) / elements
    area, second = section.area(point), section.second_moment(point)
    bending = material.young_modulus * second
    lateral = section.shear_factor * material.shear_modulus * area
    natural = geometry.natural_shape(2 * elements + 1)
    slope = SLOPE * 2 / size
    share, fraction = _simpson(elements) * length, np.linspace(0.0, 1.0, 2 * elements + 1)
    mass = material.density * share * section.area(fraction)
    inertia = material.density * share * section.second_moment(fraction)
    return Mesh(
        natural=natural,
        strain=_strains(natural, slope),
        axial=material.young_modulus * area * size / 2,
        shear=(lateral if shear else RIGID_IN_SHEAR * bending / length**2) * size / 2,
        bending=bending * size / 2,
        mass=np.column_stack([mass, mass, inertia * rotary_inertia]),
        metric=np.column_stack([mass, mass, mass * length**2 / 12]),
        held=np.array([[end.x, end.y, end.angle] for end in (base, tip)]),
        slope=slope,
        length=length,
        damping_time=material.damping_time,
    )


def _simpson(elements: int) -> Array:
    """(2 E + 1,) weights of Simpson's rule over [0, 1]."""
    weight = np.where(np.arange(2 * elements + 1) % 2, 4.0, 2.0)
    weight[[0, -1]] = 1.0
    return weight / (6 * elements)


def _strains(pose: Array, slope: Array) -> Array:
    """(E, 2, 3) strains R^T r' and angle' of poses (n, 3) at the Gauss points."""
    element = pose[np.arange(0, len(pose) - 1, 2)[:, None] + np.arange(3)]
    rate = np.einsum("ga,eai->egi", slope, element)
    angle = np.einsum("ga,ea->eg", SHAPE, element[..., 2])
    c, s = np.cos(angle), np.sin(angle)
    x, y = rate[..., 0], rate[..., 1]
    return np.stack([c * x + s * y, c * y - s * x, rate[..., 2]], axis=-1)


def _need(holds: bool, rule: str) -> None:
    if not holds:
        raise RodError(rule)


def _need_finite(*values: float) -> None:
    _need(all(math.isfinite(value) for value in values), f"{values} must be finite")
