"""References for the rod: closed forms, published figures and collocation of Reissner's equations.

Lengths are in units of L and loads in units of EI / L^2, unless stated otherwise.
"""

import math
from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from slot_core.robot import Array
from slot_core.rod.model import RIGID_IN_SHEAR, Geometry, Loads, Material, Rectangle

LEG = Geometry(0.19, Rectangle(0.02, (0.0135, 0.0035)))
TPU = Material(1e7, 1e7 / 3, 1200.0, 5e-4)
PUSH = Loads(force=(0.0, -1.0))

THIN = 1e-3  # thickness over length: with EI = L = 1 the elastica, stretched by 1e-7
THIN_MATERIAL = Material(12 / THIN**3, 4 / THIN**3, 1 / THIN, 0.0)

EULER = math.pi**2 / 4  # P L^2 / EI, clamped and free
# w L^3 / EI at which an upright column buckles under its own weight: 9/4 j^2 with the first zero j
# of the Bessel function J_(-1/3) (Greenhill 1881).
GREENHILL = 9 / 4 * 1.8663508588738948**2

FREQUENCIES = {  # rad/s with EI = rho A = L = 1; the leg's in Hz
    "uniform": np.array([1.8751040687, 4.6940911330, 7.8547574382]) ** 2,
    "tapered": np.array([3.8237848473, 18.3172609042, 47.2648270105]),
    "leg": np.array([6.5209720302, 25.5124367433, 61.3511026964]),
}

Field = Callable[[Array], Array]


def elastica(p: float) -> Array:
    """Tip (x, y) of the inextensible cantilever under the dead load p (Bisshopp, Drucker 1945)."""

    def excess(angle: float) -> float:
        m = (1 + math.sin(angle)) / 2
        return float(ellipk(m) - ellipkinc(math.asin(math.sqrt(0.5 / m)), m)) - math.sqrt(p)

    angle = brentq(excess, 1e-12, math.pi / 2 - 1e-12, xtol=1e-14)
    m = (1 + math.sin(angle)) / 2
    second = ellipe(m) - ellipeinc(math.asin(math.sqrt(0.5 / m)), m)
    return np.array([math.sqrt(2 * math.sin(angle) / p), 1 - 2 * second / math.sqrt(p)])


def follower(p: float) -> Array:
    """Tip (x, y) of the inextensible cantilever under a follower force p, normal to its tip.

    The angle psi, from the tip backwards, obeys psi'' = p cos psi, so psi'^2 = 2 p sin psi. With
    cos phi = sqrt(sin psi) lengths are elliptic integrals of modulus k^2 = 1/2: the tip's angle a
    follows from sqrt p = K - F(phi(a)), and in the tip's axes

        integral of cos psi = sqrt(2 sin a / p),  of sin psi = 2 (E - E(phi(a))) / sqrt p - 1.
    """

    def phi(angle: float) -> float:
        return math.asin(math.sqrt(2) * math.sin((math.pi / 2 - angle) / 2))

    def excess(angle: float) -> float:
        return float(ellipk(0.5) - ellipkinc(phi(angle), 0.5)) - math.sqrt(p)

    angle = brentq(excess, 1e-9, math.pi - 1e-9, xtol=1e-14)
    along = math.sqrt(2 * math.sin(angle) / p)
    across = 2 * (ellipe(0.5) - ellipeinc(phi(angle), 0.5)) / math.sqrt(p) - 1
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * along + s * across, s * along - c * across])


def collocation(
    load: Callable[[Array, float], Array],
    bending: Field,
    axial: Field,
    lateral: Field,
    length: float = 1.0,
) -> Array:
    """Tip pose of a rod clamped along x, in the units of its arguments, from Reissner's equations.

    With n = load(s, tip angle), (2, m), the force on the part beyond s: angle' = M / EI,
    r' = R (1 + n.t / EA, n.d / GA), M' = -r' x n. A stiffness may be infinite. Raises
    ArithmeticError if the collocation does not converge.
    """

    def slope(s: Array, y: Array, tip: Array) -> Array:
        n, cos, sin = load(s, tip[0]), np.cos(y[0]), np.sin(y[0])
        along = 1 + (cos * n[0] + sin * n[1]) / axial(s)
        across = (cos * n[1] - sin * n[0]) / lateral(s)
        x, z = cos * along - sin * across, sin * along + cos * across
        return np.array([y[1] / bending(s), z * n[0] - x * n[1], x, z])

    def ends(a: Array, b: Array, tip: Array) -> Array:
        return np.array([a[0], b[1], a[2], a[3], b[0] - tip[0]])

    s = np.linspace(0.0, length, 401)
    solution = solve_bvp(
        slope, ends, s, np.array([0 * s, 0 * s, s, 0 * s]), p=[0.0], tol=1e-9, max_nodes=100_000
    )
    if not solution.success:
        raise ArithmeticError(f"no reference for the rod: {solution.message}")
    tip: Array = solution.y[[2, 3, 0], -1]
    return tip


def constant(value: float) -> Field:
    """Field of one constant value."""
    return lambda s: np.full_like(s, value)


def dead(p: float) -> Callable[[Array, float], Array]:
    """Dead load: a force p along y at the tip."""
    return lambda s, _: np.array([0 * s, p + 0 * s])


def across_tip(p: float) -> Callable[[Array, float], Array]:
    """Follower force: a force p that stays normal to the tip."""
    return lambda s, tip: np.array([-p * np.sin(tip) + 0 * s, p * np.cos(tip) + 0 * s])


def weight(w: float) -> Callable[[Array, float], Array]:
    """Own weight w per length along -y."""
    return lambda s, _: np.array([0 * s, -w * (1 - s)])


def heavy(w: float) -> Array:
    """Tip (x, y) of the inextensible cantilever under its own weight w."""
    return collocation(weight(w), constant(1.0), constant(math.inf), constant(math.inf))[:2]


def thin(load: Callable[[Array, float], Array]) -> Array:
    """Tip (x, y) of the thin rod that represents the elastica, with its stretch and stiff shear."""
    axial = constant(THIN_MATERIAL.young_modulus * THIN)
    return collocation(load, constant(1.0), axial, constant(RIGID_IN_SHEAR))[:2]


def leg_tip(shear: bool) -> Array:
    """Tip (x, y) of the leg under PUSH, m."""
    section, length = LEG.section, LEG.length
    shear_modulus = TPU.shear_modulus * section.shear_factor if shear else math.inf
    return collocation(
        dead(PUSH.force[1]),
        lambda s: TPU.young_modulus * section.second_moment(s / length),
        lambda s: TPU.young_modulus * section.area(s / length),
        lambda s: shear_modulus * section.area(s / length),
        length,
    )[:2]
