"""References for the rod: closed forms, published figures and collocation of Cosserat's equations.

Lengths are in units of L and loads in units of EI / L^2, unless stated otherwise.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_bvp
from scipy.linalg import eigh

from slot_core.arrays import Array
from slot_core.rod.model import (
    Geometry,
    Loads,
    Material,
    Rectangle,
    RodTendon,
    Uniform,
)

THIN = 1e-3  # thickness over length: with EI = L = 1 the elastica, stretched by 1e-7
THIN_MATERIAL = Material(12 / THIN**3, 4 / THIN**3, 1 / THIN, 0.0)
# of sections that are given by their stiffness
UNIT = Material(1.0, 1.0, 1e-6, 0.0)
Field = Callable[[Array], Array]

RAMP = (0.25, 0.5, 0.75, 1.0)  # load factors of the collocation

EULER = math.pi**2 / 4  # P L^2 / EI, clamped and free
# w L^3 / EI at which an upright column buckles under its own weight: 9/4 j^2 with the first zero j
# of the Bessel function J_(-1/3) (Greenhill 1881).
GREENHILL = 9 / 4 * 1.8663508588738948**2
LATERAL = 4.0126  # P L^2 / sqrt(EI GJ): a narrow cantilever buckles sideways (Prandtl 1899)

FREQUENCIES = {  # rad/s with EI = rho A = L = 1; the leg's in Hz
    "uniform": np.array([1.8751040687, 4.6940911330, 7.8547574382]) ** 2,
    "tapered": np.array([3.8237848473, 18.3172609042, 47.2648270105]),
    "leg": np.array([6.5209720302, 25.5124367433, 61.3511026964]),
}

# The 45 degree bend of Bathe and Bolourchi (1979): radius 100, a unit square, tip loads out of its
# plane. Tips of Simo and Vu-Quoc (1986) along the base's tangent, across the plane, and towards the
# centre. They take the polar moment, 1/6, for the torsion constant.
BEND = Geometry(25 * math.pi, Uniform(1.0, 1 / 12, 1 / 12, 1 / 6), 0.01)
BEND_MATERIAL = Material(1e7, 5e6, 1.0, 0.0)
BEND_TIPS = {300.0: (58.84, 40.08, 22.33), 600.0: (47.23, 53.37, 15.79)}

# Princeton's beam (Dowell and Traybar 1975): tip displacements (m) along the stiff and the soft
# axis over the angle (deg) of the load from the stiff one, by Ansys beams (Obrezkov et al. 2022).
# Saint-Venant's torsion constant of the section, .210 (I1 + I2), is taken here. With .198, which
# that paper names, the stiff component of our rod and of the collocation is up to 2.3 % larger.
PRINCETON = Geometry(0.508, Rectangle(12.3777e-3, (3.2024e-3, 3.2024e-3)))
PRINCETON_MATERIAL = Material(71.7e9, 71.7e9 / 2.62, 2700.0, 0.0)
PRINCETON_FORCE = 8.896  # N
PRINCETON_TIPS = {
    0: (0.010714, 0.0),
    15: (0.010613, 0.042082),
    30: (0.010112, 0.079395),
    45: (0.008837, 0.108988),
    60: (0.006605, 0.129888),
    75: (0.003539, 0.142194),
    90: (0.0, 0.146246),
}


# A steel rod with tendons under its weight, by Till's programs of Rucker and Webster's equations
# (github.com/JohnDTill/ContinuumRobotExamples, 05_Tendon_Robot, 06_Tendon_Robot_Variants): one
# straight tendon of 15 N, one on a helix, and four of which one is drawn in and one let out by 5 mm.
# Shear, which they have, is below 1e-5 of the length. Tendons, loads, tip (m), error of the rod.
WIRE = math.pi * 1e-6  # m^2
TENDON_ROBOT = (
    Material(200e9, 80e9, 8000.0, 0.0),
    Geometry(0.5, Uniform(WIRE, WIRE / 4e6, WIRE / 4e6, WIRE / 2e6)),
)
REACH, SIDEWAYS = 0.01506, (0.0, 9.81, 0.0)  # m, m/s^2
TURN = np.linspace(0.0, 2 * math.pi, 31)
HELIX = RodTendon(REACH * np.column_stack([np.cos(TURN), np.sin(TURN)]))
FOUR = [
    RodTendon((REACH * y, REACH * z), stiffness=2e4)
    for y, z in ((1, 0), (0, 1), (-1, 0), (0, -1))
]
PULLED = Loads(gravity=SIDEWAYS, pull=(15.0,))
TENDON_TIPS = [
    ([RodTendon((REACH, 0.0))], PULLED, (0.453229, 0.182212, 0.0), 1e-5),
    ([HELIX], PULLED, (0.493348, 0.0122099, 0.0581888), 5e-5),
    (
        FOUR,
        Loads(gravity=SIDEWAYS, length=(0.495, 0.5, 0.505, 0.5)),
        (0.491303, 0.0814279, 0.0),
        2e-6,
    ),
]


def axes(q: Array) -> Array:
    """(3, 3, ...) columns tangent, width, normal of quaternions (4, ...) of any length."""
    w, x, y, z = q / np.sqrt((q * q).sum(axis=0))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def slope(
    material: Material, geometry: Geometry, gravity: Array, s: Array, y: Array
) -> Array:
    """Cosserat's equations without shear: derivative of y (13, n) by the arc length s (n,).

    y is the place r, a quaternion q of the axes R, the force n and the moment m on the part beyond:

        r' = R t (1 + n.t / EA),  q' = q (0, kappa) / 2,  n' = -rho A g,  m' = -r' x n,

    with kappa = B^-1 R^T m + kappa0 and t the first axis.
    """
    q, force = y[3:7], y[7:10]
    area, inner, outer, torsion = geometry.section.constants(
        s / geometry.length
    )
    frame, young = axes(q), material.young_modulus
    shear = material.shear_modulus
    stiffness = [shear * torsion, young * inner, young * outer]
    kappa = np.einsum("ijk,ik->jk", frame, y[10:]) / stiffness
    kappa[1] -= geometry.curvature_at(s)
    tangent = frame[:, 0] * (
        1 + (frame[:, 0] * force).sum(axis=0) / (young * area)
    )
    turned = np.vstack(
        [
            -(q[1:] * kappa).sum(axis=0),
            q[0] * kappa + np.cross(q[1:], kappa, axis=0),
        ]
    )
    return np.vstack(
        [
            tangent,
            turned / 2,
            -np.outer(gravity, material.density * area),
            -np.cross(tangent, force, axis=0),
        ]
    )


def collocation(material: Material, geometry: Geometry, loads: Loads) -> Array:
    """(13,) state (see `slope`) at the tip of a rod that is clamped at the origin along x.

    Raises ArithmeticError if the collocation does not converge.
    """
    parts = [
        np.array(part)
        for part in (loads.gravity, loads.force, loads.moment, loads.follower)
    ]
    s = np.linspace(0.0, geometry.length, 201)
    y = np.zeros((13, len(s)))
    shape = geometry.natural_shape(len(s))
    y[0], y[2] = shape[:, 0], shape[:, 1]
    y[3], y[5] = np.cos(shape[:, 2] / 2), -np.sin(shape[:, 2] / 2)
    for factor in RAMP:
        gravity, force, moment, own = (factor * part for part in parts)

        def ends(
            a: Array,
            b: Array,
            force: Array = force,
            moment: Array = moment,
            own: Array = own,
        ) -> Array:
            start = a[:7] - [0, 0, 0, 1, 0, 0, 0]
            return np.concatenate(
                [start, b[7:10] - force - axes(b[3:7]) @ own, b[10:] - moment]
            )

        def rate(s: Array, y: Array, gravity: Array = gravity) -> Array:
            return slope(material, geometry, gravity, s, y)

        found: Any = solve_bvp(
            rate,
            ends,
            s,
            y,
            tol=1e-10 if factor == RAMP[-1] else 1e-4,
            max_nodes=100_000,
        )
        if not found.success:
            raise ArithmeticError(f"no reference for the rod: {found.message}")
        y = found.sol(s)
    return found.y[:, -1]


def tip(material: Material, geometry: Geometry, loads: Loads) -> Array:
    """(3,) place of the tip of a clamped rod, in its units."""
    return collocation(material, geometry, loads)[:3]


def sideways(material: Material, geometry: Geometry, count: int) -> Array:
    """Lowest frequencies (count,), Hz, of a straight cantilever that bends sideways (`_ritz`)."""
    constants = geometry.section.constants
    speed = math.sqrt(material.young_modulus / material.density)
    found = speed * _ritz(
        lambda f: constants(f)[2], lambda f: constants(f)[0], 2
    )
    return found[:count] / (2 * math.pi * geometry.length**2)


def twisting(material: Material, geometry: Geometry, count: int) -> Array:
    """Lowest frequencies (count,), Hz, of a straight cantilever that twists (`_ritz`)."""
    constants = geometry.section.constants
    speed = math.sqrt(material.shear_modulus / material.density)
    found = speed * _ritz(
        lambda f: constants(f)[3], lambda f: sum(constants(f)[1:3]), 1
    )
    return found[:count] / (2 * math.pi * geometry.length)


def _ritz(stiffness: Field, mass: Field, order: int) -> Array:
    """Frequencies w of -+(k u^(n))^(n) = w^2 m u on 0 .. 1, held at 0: Ritz's method.

    n = order; the trial functions x^n P_j(2 x - 1) with Legendre's polynomials meet u = 0 and, for
    n = 2, u' = 0 at the clamp.
    """
    x, weight = np.polynomial.legendre.leggauss(60)
    x, weight = (x + 1) / 2, weight / 2
    power = np.polynomial.Polynomial([0.0] * order + [1.0])
    shapes = [
        power
        * np.polynomial.Legendre.basis(j, domain=[0, 1]).convert(
            kind=np.polynomial.Polynomial
        )
        for j in range(16)
    ]
    bent = np.array([shape.deriv(order)(x) for shape in shapes])
    moved = np.array([shape(x) for shape in shapes])
    return np.sqrt(
        eigh(
            (bent * weight * stiffness(x)) @ bent.T,
            (moved * weight * mass(x)) @ moved.T,
            eigvals_only=True,
        )
    )
