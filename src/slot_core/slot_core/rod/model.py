"""Description of a rod: material, section, natural shape, supports, loads, scheme and state.

The rod has the length L, its base at s = 0 and its tip at s = L, and a support at each. The axes of
a section are the tangent, the width and the normal; at a base with the rotation zero they are x, y
and z. The natural shape lies in the base's plane of tangent and normal.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from slot_core import section as moments
from slot_core.arrays import Array, checked
from slot_core.refusal import InputError, quoted

Vector = tuple[float, float, float]
Components = tuple[bool, bool, bool]
Constants = tuple[Array, Array, Array, Array]  # see `Section.constants`

NOWHERE: Vector = (0.0, 0.0, 0.0)
ALL_COMPONENTS: Components = (True, True, True)
NONE: Components = (False, False, False)


class RodError(InputError):
    """Invalid argument of a rod; the message names the quantity, its value and the limit."""


def need(holds: bool, rule: str) -> None:
    """Raise RodError with a rule that does not hold."""
    if not holds:
        raise RodError(rule)


def need_positive(name: str, *values: float) -> None:
    """Raise RodError for a value that is not above 0 and finite."""
    shown = values[0] if len(values) == 1 else values
    good = all(0.0 < value < math.inf for value in values)
    need(good, f"{name} {shown} must be above 0 and finite")


def need_not_below_zero(name: str, value: float) -> None:
    """Raise RodError for a value that is below 0 or not finite."""
    good = 0.0 <= value < math.inf
    need(good, f"{name} {value} must be finite and not below 0")


def need_vector(name: str, values: Vector) -> None:
    """Raise RodError unless there are three finite numbers."""
    checked(name, values, (3,), error=RodError)


def numbers(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Finite numbers of a shape, a single one for all; raises RodError."""
    try:
        found = np.broadcast_to(np.asarray(values, dtype=np.float64), shape)
    except (TypeError, ValueError):
        raise RodError(
            f"{name} {quoted(values)} must be numbers of shape {shape}"
        ) from None
    need(bool(np.isfinite(found).all()), f"{name} must be finite")
    return np.array(found)


@dataclass(frozen=True)
class Material:
    """Kelvin-Voigt material: stress = modulus (strain + damping_time d(strain)/dt), all strains.

    Raises RodError for values that are not finite or not positive (damping_time: negative).
    """

    young_modulus: float  # Pa
    shear_modulus: float  # Pa, of torsion
    density: float  # kg/m^3
    damping_time: float  # s

    def __post_init__(self) -> None:
        for name in ("young_modulus", "shear_modulus", "density"):
            need_positive(name, getattr(self, name))
        need_not_below_zero("damping_time", self.damping_time)


class Section(Protocol):
    """Cross-section along the rod, over the fraction s / L. Its polar moment is the sum of both."""

    def constants(self, fraction: Array) -> Constants:
        """Constants of the sections at fractions (n,), each (n,).

        Area, m^2; second moments of area for bending in the natural shape's plane, about the width,
        and sideways, m^4; torsion constant J, m^4: torque = G J times twist per length.
        """


@dataclass(frozen=True)
class Rectangle:
    """Rectangle: constant width, thickness linear from base to tip.

    Raises RodError for dimensions that are not positive and finite.
    """

    width: float  # m
    thickness: tuple[float, float]  # m, at base and tip

    def __post_init__(self) -> None:
        need_positive("width", self.width)
        need_positive("thickness", *self.thickness)

    def constants(self, fraction: Array) -> Constants:
        """Area, second moments, and Saint-Venant's torsion constant (`Section`)."""
        width, thick = self.width, _linear(self.thickness, fraction)
        return (
            width * thick,
            moments.second_moment(width, thick),
            moments.second_moment(thick, width),
            moments.torsion_constant(width, thick),
        )


@dataclass(frozen=True)
class Circle:
    """Solid circle, diameter linear from base to tip.

    Raises RodError for diameters that are not positive and finite.
    """

    diameter: tuple[float, float]  # m, at base and tip

    def __post_init__(self) -> None:
        need_positive("diameter", *self.diameter)

    def constants(self, fraction: Array) -> Constants:
        """Area, second moments and torsion constant (`Section`)."""
        diameter = _linear(self.diameter, fraction)
        second = math.pi / 64 * diameter**4
        return math.pi / 4 * diameter**2, second, second, 2 * second


@dataclass(frozen=True)
class Uniform:
    """The same section everywhere, by its four constants.

    Raises RodError for constants that are not positive and finite.
    """

    area_m2: float
    inner: float  # m^4, second moment for bending in the natural shape's plane
    outer: float  # m^4, sideways
    torsion: float  # m^4, torsion constant

    def __post_init__(self) -> None:
        need_positive(
            "section", self.area_m2, self.inner, self.outer, self.torsion
        )

    def constants(self, fraction: Array) -> Constants:
        """The four constants at all fractions (`Section`)."""
        parts = (self.area_m2, self.inner, self.outer, self.torsion)
        area, inner, outer, torsion = np.multiply.outer(
            parts, np.ones_like(fraction)
        )
        return area, inner, outer, torsion


def _linear(ends: tuple[float, float], fraction: Array) -> Array:
    return ends[0] + (ends[1] - ends[0]) * fraction


@dataclass(frozen=True)
class Geometry:
    """Length, section and natural curvature of a rod.

    curvature: 1/m, a number or a function of s (m); a positive one turns the tangent towards the
    normal, x towards z. Raises RodError for an invalid length.
    """

    length: float  # m
    section: Section
    curvature: float | Callable[[Array], Array] = 0.0

    def __post_init__(self) -> None:
        need_positive("length", self.length)

    def natural_shape(self, nodes: int) -> Array:
        """(nodes, 3) natural x, z and angle from x to z, m, m, rad, from the origin along x.

        Integrates angle' = curvature and r' = (cos angle, sin angle) with Gauss's rule on each
        interval, and on parts of it for the angle at the Gauss points. The error is that of
        rounding where the curvature is smooth.
        """
        x, w = np.polynomial.legendre.leggauss(8)
        x, w = (x + 1) / 2, w / 2
        cell = self.length / (nodes - 1)
        start = np.arange(nodes - 1) * cell
        # points up to each point
        inner = start[:, None, None] + cell * x[:, None] * x
        part = cell * x * (self.curvature_at(inner) @ w)
        whole = cell * (self.curvature_at(start[:, None] + cell * x) @ w)
        angle = np.concatenate([[0.0], np.cumsum(whole)])
        inside = angle[:-1, None] + part
        steps = cell * np.stack(
            [np.cos(inside) @ w, np.sin(inside) @ w], axis=1
        )
        return np.column_stack(
            [np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)]), angle]
        )

    def curvature_at(self, s: Array) -> Array:
        """Natural curvature at arc lengths s (m), 1/m."""
        value = (
            self.curvature(s) if callable(self.curvature) else self.curvature
        )
        return numbers("curvature", value, s.shape)


@dataclass(frozen=True)
class Pose:
    """Position (m) and rotation vector (rad) of an end; its section's axes turn from x, y, z.

    Raises RodError for a vector that is not of three finite numbers.
    """

    position: Vector = NOWHERE
    rotation: Vector = NOWHERE

    def __post_init__(self) -> None:
        need_vector("position", self.position)
        need_vector("rotation", self.rotation)


@dataclass(frozen=True)
class Support:
    """Components along x, y and z of an end's position and of its section's turning that are held.

    Held turning: the section's angular velocity about that axis is prescribed. Raises RodError
    unless there are three of each.
    """

    position: Components
    rotation: Components

    def __post_init__(self) -> None:
        for held in (self.position, self.rotation):
            are_three = (
                np.shape(held) == (3,) and np.asarray(held).dtype == bool
            )
            need(
                are_three,
                f"{quoted(held)} must be whether each of 3 components is held",
            )


CLAMPED = Support(ALL_COMPONENTS, ALL_COMPONENTS)
PINNED = Support(ALL_COMPONENTS, (True, False, False))  # turns about y and z
FREE = Support(NONE, NONE)
ROLLER = Support((False, True, True), NONE)  # slides along x


@dataclass(frozen=True)
class RodTendon:
    """A cable without friction from the base's section to the tip's, through holes in all sections.

    At the offset p(s) in a section's axes the cable's tangent is g / |g| with

        g = (1 + e) t + u x p + dp/ds,      l = int |g| ds,      T = max(0, pull + k (l - length)),

    e the stretch, u = (twist, bending) the curvature and l the length of the path (Rucker and
    Webster, IEEE Trans. Robotics 27, 2011). It pulls and never pushes. Its forces on the rod are
    -T grad l, so along a curve it presses on the sections as Rucker and Webster's cable does. A
    stretch e lengthens an inclined cable as at rest, by cos(inclination) e.

    A constant offset d on the side of the normal bends a straight rod to the curvature T d / EI
    towards the normal. Pull and length are a part of `Loads`. The error is of fourth order in the
    length of a segment for a constant offset, else of second order.

    Raises RodError for a stiffness that is below 0 or not finite; the rod raises it for an offset
    that is not of two numbers, or of two for each node.
    """

    offset: (
        tuple[float, float] | Array
    )  # (2,) or (N, 2) m along width and normal
    stiffness: float = (
        0.0  # N/m, k of the whole cable; needed by a given length
    )

    def __post_init__(self) -> None:
        need_not_below_zero("stiffness", self.stiffness)


@dataclass(frozen=True)
class Plane:
    """A wall or floor that the rod cannot enter; it touches the rod at the nodes.

    At a node whose gap g = normal . (r - point) - radius is below 0 the force per length of the rod
    is N n - f with the law of the robot's feet (`dynamics/contact.py`):

        N = max(0, -stiffness g - damping dg/dt),      f = friction N v / sqrt(v^2 + creep^2),

    v the velocity along the plane: Coulomb's friction, which creeps under a load at rest. Statics
    has no friction. The force acts on the centre line: friction does not roll or twist the rod.

    Raises RodError for a vector that is not of three finite numbers, a normal of length 0, a
    stiffness or creep that is not above 0, other numbers below 0.
    """

    point: Vector  # m, of the plane
    normal: Vector  # out of the wall, of any length
    stiffness: float  # N/m^2: N/m per m of the rod
    radius: float = 0.0  # m, from the centre line to the rod's surface
    damping: float = 0.0  # N s/m^2
    friction: float = 0.0
    creep: float = 1e-3  # m/s

    def __post_init__(self) -> None:
        need_vector("point", self.point)
        need_vector("normal", self.normal)
        need(any(self.normal), f"normal {self.normal} must not be 0")
        need_positive("stiffness", self.stiffness)
        need_positive("creep", self.creep)
        for name in ("radius", "damping", "friction"):
            need_not_below_zero(name, getattr(self, name))


@dataclass(frozen=True)
class Loads:
    """Dead loads, of fixed direction, a follower force, which turns with the tip, and tendons.

    A dead moment in space has no potential. Raises RodError for a vector that is not of three
    finite numbers; the rod raises it for another number of tendons, a pull below 0, or a length
    without a tendon that has a stiffness.
    """

    gravity: Vector = NOWHERE  # m/s^2
    force: Vector = NOWHERE  # N, at the tip
    moment: Vector = NOWHERE  # N m, at the tip
    # N, at the tip, along its section's tangent, width and normal
    follower: Vector = NOWHERE
    line: Vector | Array = NOWHERE  # (3,) or (N, 3) N/m of the natural length
    pull: tuple[float, ...] | None = None  # N, of each tendon; None: 0
    # m, of each cable without pull (`RodTendon`); None: they give way
    length: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        for name in ("gravity", "force", "moment", "follower"):
            need_vector(name, getattr(self, name))


@dataclass(frozen=True)
class Scheme:
    """Theta time integration: forces are evaluated at t + theta h.

    theta = 1/2 is the implicit midpoint rule. It is of second order and conserves linear and
    angular momentum up to `tolerance`. It does not conserve energy: where the step resolves the
    motion, the energy oscillates about its initial value. Above 1/2 the scheme is of first order
    and damps motion that the step does not resolve.

    Raises RodError for theta outside of 0.5 .. 1, fewer than one iteration, a tolerance below 0.
    """

    theta: float = 0.5
    iterations: int = 20  # of Newton's method, at most
    # of Newton's last increment, in rad and rod lengths
    tolerance: float = 1e-9

    def __post_init__(self) -> None:
        need(
            0.5 <= self.theta <= 1.0,
            f"theta {self.theta} must be within 0.5 .. 1",
        )
        need(
            self.iterations >= 1,
            f"iterations {self.iterations} must be at least 1",
        )
        need(
            self.tolerance >= 0.0,
            f"tolerance {self.tolerance} must not be below 0",
        )


MIDPOINT = Scheme()


@dataclass(frozen=True)
class RodState:
    """State of a rod of N nodes.

    The directors are unit vectors normal to their segments, against the width. The swirl is the
    angular momentum of each segment about itself over its polar moment of inertia: its spin times
    its direction. The columns of an end's axes are its section's tangent, width and normal.
    """

    position: Array  # (N, 3) m
    director: Array  # (N-1, 3)
    velocity: Array  # (N, 3) m/s
    swirl: Array  # (N-1, 3) rad/s
    ends: Array  # (2, 3, 3) axes of the sections at base and tip


@dataclass(frozen=True)
class Energy:
    """Energies, J. The potential of gravity and dead forces is zero at the origin.

    Tendons and planes are not counted.
    """

    kinetic: float
    elastic: float
    potential: float

    @property
    def total(self) -> float:
        """Sum of the three, J."""
        return self.kinetic + self.elastic + self.potential
