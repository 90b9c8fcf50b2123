"""Equilibria of the Cosserat rod against closed forms, published figures and collocation."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_bvp
from scipy.linalg import eig
from scipy.optimize import brentq
from scipy.special import ellipk

from benchmarks.rod.release import LEG, TPU
from slot_core.arrays import Array
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import (
    CLAMPED,
    PINNED,
    ROLLER,
    Circle,
    Geometry,
    Loads,
    Material,
    Plane,
    Pose,
    Rectangle,
    RodError,
    RodTendon,
    Scheme,
    Support,
    Uniform,
)
from slot_core.rod.statics import (
    Branch,
    EquilibriumError,
    StaticSettings,
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

STRIP = Geometry(1.0, Rectangle(1.0, (THIN, THIN)))
# L = EI = rho A = 1, EI sideways 2, GJ 0.8; it stretches by 1e-6 under a unit force.
OBLONG = Geometry(1.0, Uniform(1e6, 1.0, 2.0, 0.8))


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


def collocated_tip(
    material: Material, geometry: Geometry, loads: Loads
) -> Array:
    """(3,) place of the tip of a clamped rod, in its units."""
    return collocation(material, geometry, loads)[:3]


def slender(nodes=31, **options):
    """Rod with L = EI = rho A = 1 in the plane, strain 1e-7 under a unit force, stiff sideways."""
    return CosseratRod(THIN_MATERIAL, STRIP, nodes, **options)


def place(rod):
    return np.array(rod.tip.position)


def error(rod, tip):
    """Distance of the tip from a place, over the length."""
    return math.dist(place(rod), tip) / rod.mesh.length


FORCES = [
    (0.0, 0.0, 3.0),
    (0.5, 2.0, 2.0),
    (-1.0, 1.0, 3.0),
    (0.3, -2.5, 0.7),
    (0.0, 2.0, 0.0),
]


@pytest.mark.parametrize("force", FORCES)
@pytest.mark.parametrize("curvature", [0.0, 1.0])
def test_tip_force_in_any_direction_bends_and_twists_as_in_cosserats_equations(
    force, curvature
):
    geometry, loads = (
        Geometry(1.0, OBLONG.section, curvature),
        Loads(force=force),
    )
    tip, errors = collocated_tip(UNIT, geometry, loads), []
    for nodes in (16, 31, 61):
        rod = CosseratRod(UNIT, geometry, nodes)
        rod.solve_static(loads)
        errors.append(error(rod, tip))
    assert errors[2] < 1e-6
    # third order gives 64; some errors are small throughout
    assert errors[0] / errors[2] > 30


@pytest.mark.parametrize(
    "loads",
    [
        Loads(gravity=(30.0, 40.0, -60.0)),
        Loads(follower=(-0.5, 0.6, 1.0)),
        Loads(force=(0.0, 0.2, 0.5), moment=(0.03, 0.03, -0.05)),
        Loads(
            force=(0.5, 0.1, 0.0),
            moment=(0.0, 0.02, 0.05),
            follower=(-0.5, 0.1, 0.3),
            gravity=(0.0, 0.0, 9.81),
        ),
    ],
)
def test_curved_tapered_leg_bends_as_in_cosserats_equations(loads):
    geometry = Geometry(LEG.length, LEG.section, curvature=3.0)
    wanted, errors, turns = (
        collocation(TPU, geometry, loads),
        [],
        [],
    )
    for nodes in (31, 61):
        rod = CosseratRod(TPU, geometry, nodes)
        rod.solve_static(loads)
        errors.append(error(rod, wanted[:3]))
        turns.append(np.abs(rod.state.ends[1] - axes(wanted[3:7])).max())
    # 7e-6 under its weight; the leg is four times as thick at its base
    assert errors[1] < 1e-5
    assert turns[1] < 2e-4
    # Third order gives 8; weights at nodes beside the curve leave a small term of second order.
    assert errors[0] / errors[1] > (3.5 if any(loads.gravity) else 6)


# Bathe and Bolourchi's bend, which leaves its plane; displacements of the Princeton beam.
PUBLISHED = [
    ((BEND_MATERIAL, BEND, 61), (0.0, force, 0.0), tip)
    for force, tip in BEND_TIPS.items()
] + [
    (
        (PRINCETON_MATERIAL, PRINCETON),
        (
            0.0,
            PRINCETON_FORCE * math.cos(math.radians(degrees)),
            PRINCETON_FORCE * math.sin(math.radians(degrees)),
        ),
        tip,
    )
    for degrees, tip in PRINCETON_TIPS.items()
]


@pytest.mark.parametrize(("parts", "force", "tip"), PUBLISHED)
def test_published_tips_of_beams_that_bend_in_space(parts, force, tip):
    rod = CosseratRod(*parts)
    rod.solve_static(Loads(force=force))
    np.testing.assert_allclose(
        place(rod)[-len(tip) :], tip, rtol=0.01, atol=1e-9
    )


@pytest.mark.parametrize(("axis", "side"), [(0, 1), (0, -1), (1, 1), (1, -1)])
def test_a_tendon_bends_a_straight_rod_to_a_circle(axis, side):
    """Curvature T d / EI by its natural length, stretch -T / EA, towards the tendon."""
    geometry = Geometry(1.0, Uniform(1e3, 1.0, 2.0, 0.8))  # EI = 2 sideways
    offset, pull, errors = side * 0.1 * np.eye(2)[axis], 20.0, []
    curvature, stretched = 2.0 / (2 - axis), 1 - pull / 1e3
    wanted = [math.sin(curvature), 0.0, 0.0]
    wanted[1 + axis] = side * (1 - math.cos(curvature))
    for nodes in (9, 17, 33):
        rod = CosseratRod(UNIT, geometry, nodes, tendons=[RodTendon(offset)])
        rod.solve_static(Loads(pull=(pull,)))
        angle = [0.0, -side * curvature, 0.0] if axis else [0.0, 0.0, side]
        np.testing.assert_allclose(rod.tip.rotation, angle, atol=1e-9)
        length = stretched - 0.1 * curvature
        np.testing.assert_allclose(rod.tendons, [[pull, length]], atol=1e-9)
        errors.append(error(rod, np.array(wanted) * stretched / curvature))
    assert errors[2] < 1e-5
    assert np.log2(errors[0] / errors[2]) / 2 > 2.9


@pytest.mark.parametrize(("tendons", "loads", "tip", "most"), TENDON_TIPS)
def test_tips_of_tendon_robots_that_bend_under_their_weight(
    tendons, loads, tip, most
):
    rod = CosseratRod(*TENDON_ROBOT, tendons=tendons)
    rod.solve_static(loads)
    np.testing.assert_allclose(place(rod), tip, atol=most)


def test_a_line_load_of_a_rods_weight_is_its_weight():
    rod, weight = CosseratRod(UNIT, OBLONG), np.array([1.0, 3.0, -5.0])
    line = np.outer(np.linspace(0.0, 1.0, rod.nodes), weight)
    places = []
    for loads in (Loads(gravity=tuple(weight)), Loads(line=tuple(weight))):
        rod.solve_static(loads)
        places.append(place(rod))
    np.testing.assert_allclose(*places, atol=1e-9)
    small = 1e-3 * line * [0.0, 0.0, 1.0]
    rod.solve_static(Loads(line=small))
    # w L^4 / EI of a load that grows to w at the tip
    assert place(rod)[2] == pytest.approx(-5e-3 * 11 / 120, rel=1e-3)


def test_narrow_cantilever_buckles_sideways_at_prandtls_load():
    # so stiff in the plane that it hardly bends before
    section = Uniform(1e6, 1e4, 1.0, 0.8)
    load = LATERAL * math.sqrt(0.8)
    rod = CosseratRod(UNIT, Geometry(1.0, section))
    found = rod.solve_static(Loads(force=(0.0, 0.0, 1.2 * load)))
    assert (found.branch, found.negative_pivots) == (Branch.UNSTABLE, 1)
    assert found.critical[0] * 1.2 == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize("nodes", [16, 31, 61])
@pytest.mark.parametrize("axis", [1, 2])
def test_end_moment_closes_the_circle(nodes, axis):
    rod, moment = CosseratRod(UNIT, OBLONG, nodes), [0.0, 0.0, 0.0]
    moment[axis] = 2 * math.pi * axis  # EI = axis
    rod.solve_static(Loads(moment=tuple(moment)))
    np.testing.assert_allclose(rod.state.ends[1], np.eye(3), atol=1e-9)
    assert error(rod, (0.0, 0.0, 0.0)) < 2.6e-5 * (31 / nodes) ** 3


def round_column():
    return CosseratRod(UNIT, Geometry(1.0, Uniform(1e6, 1.0, 1.0, 0.8)))


def pinned_column():
    return slender(base=PINNED, tip=ROLLER)


@pytest.mark.parametrize(
    ("column", "kind", "load", "planes"),
    [
        (slender, "force", EULER, 1),
        (pinned_column, "force", math.pi**2, 1),
        (round_column, "force", EULER, 2),
        (slender, "gravity", GREENHILL, 1),
    ],
)
def test_column_becomes_unstable_at_its_critical_load(
    column, kind, load, planes
):
    found = column().solve_static(Loads(**{kind: (-1.2 * load, 0.0, 0.0)}))
    assert (found.branch, found.negative_pivots) == (Branch.UNSTABLE, planes)
    assert found.critical[0] * 1.2 == pytest.approx(1.0, rel=1e-4)


@pytest.mark.parametrize(("load", "flutters"), [(19.95, False), (20.15, True)])
def test_column_under_a_follower_force_flutters_beyond_becks_load(
    load, flutters
):
    """Beck (1952): P L^2/(EI) = 20.05; sideways the rod is stiffer."""
    rod, loads = slender(), Loads(follower=(-load, 0.0, 0.0))
    rod.solve_static(loads)
    free = np.ix_(np.flatnonzero(rod.mesh.free), np.flatnonzero(rod.mesh.free))
    flexibility = eig(
        rod.mass_matrix()[free], rod.tangent(loads)[free], right=False
    )
    # 1 / omega^2; 0 without mass
    lowest = flexibility[np.argsort(-np.abs(flexibility))[:2]]
    assert (np.abs(lowest.imag).max() > 1e-3 * np.abs(lowest).max()) == flutters


@pytest.mark.parametrize("side", [1, -1])
def test_buckled_column_has_the_shape_of_the_elastica(side):
    load = 3.0
    rod = CosseratRod(UNIT, OBLONG)
    settings = StaticSettings(stay_stable=True, side=side)
    found = rod.solve_static(Loads(force=(-load, 0.0, 0.0)), settings)
    angle = brentq(
        lambda a: ellipk(math.sin(a / 2) ** 2) - math.sqrt(load), 0.1, 3.0
    )
    assert (found.branch, found.negative_pivots) == (Branch.SECONDARY, 0)
    height = 2 * math.sin(angle / 2) / math.sqrt(load)
    assert abs(place(rod)[2]) == pytest.approx(height, rel=2e-5)
    assert abs(rod.tip.rotation[1]) == pytest.approx(angle, rel=2e-5)


@pytest.mark.parametrize("base", [PINNED, CLAMPED])
def test_a_cable_of_a_given_length_bends_a_supported_rod_as_its_pull_does(base):
    """Statics, and the motion stays there: the supports hold."""
    options = {
        "base": base,
        "tip": ROLLER,
        "tendons": [RodTendon((0.0, 0.03), stiffness=1e3)],
    }
    one, other = (CosseratRod(UNIT, OBLONG, 9, **options) for _ in range(2))
    loads = Loads(length=(0.98,))
    one.solve_static(loads)
    pull = one.tendons[0, 0]
    other.solve_static(Loads(pull=(pull,)))
    assert pull > 1.0
    np.testing.assert_allclose(
        one.state.position, other.state.position, atol=1e-9
    )
    one.run(1e-3, 20, loads)
    np.testing.assert_allclose(
        one.state.position, other.state.position, atol=1e-8
    )


def test_snap_through_is_an_error_with_the_last_load_factor():
    # rise 35 mm: it snaps before any unsymmetric buckling
    thickness, curvature = (0.03, 0.28)
    material = Material(12 / thickness**3, 4 / thickness**3, 1 / thickness, 0.0)
    geometry = Geometry(1.0, Rectangle(1.0, (thickness, thickness)), -curvature)
    pose = Pose(rotation=(0.0, -curvature / 2, 0.0))
    hinge = Support((True, True, True), (True, False, True))
    rod = CosseratRod(material, geometry, 17, base=hinge, tip=hinge, pose=pose)
    free = np.flatnonzero(rod.mesh.free)
    first = np.linalg.eigvalsh(rod.tangent()[np.ix_(free, free)])[0]
    with pytest.raises(EquilibriumError, match="load factor 0") as caught:
        rod.solve_static(Loads(gravity=(0.0, 0.0, -400.0)))
    last = np.linalg.eigvalsh(rod.tangent()[np.ix_(free, free)])[0]
    # A fold: the rod is left where its tangent is nearly singular, still above the chord.
    assert 0.0 < caught.value.load_factor < 1.0
    assert abs(last) < 0.05 * first
    assert rod.state.position[8, 2] > 0.0
    # the tip's hinge holds
    np.testing.assert_allclose(place(rod)[2], 0.0, atol=1e-9)


def test_tangent_is_the_derivative_of_the_equilibrium_with_respect_to_the_loads():
    """A small change of the tip force moves the tip by the inverse of the tangent."""
    loads, small = Loads(force=(0.2, 1.0, 1.5), length=(0.9,)), 1e-5
    rod = CosseratRod(
        UNIT,
        OBLONG,
        12,
        refined=False,
        tendons=[RodTendon((0.03, 0.05), stiffness=1e3)],
        planes=[Plane((0.0, 0.0, 0.2), (0.1, 0.0, -1.0), 1e2)],
    )
    rod.solve_static(loads)
    free, start = np.flatnonzero(rod.mesh.free), place(rod)
    inverse = np.linalg.inv(rod.tangent(loads)[np.ix_(free, free)])
    tip = [np.flatnonzero(free == 4 * rod.nodes + c)[0] for c in range(3)]
    for c, force in enumerate(np.array(loads.force) + small * np.eye(3)):
        rod.solve_static(Loads(force=tuple(force), length=(0.9,)))
        np.testing.assert_allclose(
            place(rod) - start,
            small * inverse[tip, tip[c]],
            rtol=2e-4,
            atol=1e-9,
        )


@pytest.mark.parametrize(
    ("act", "rule"),
    [
        (
            lambda: Material(-1.0, 1.0, 1.0, 0.0),
            "young_modulus -1.0 must be above 0",
        ),
        (lambda: Material(math.nan, 1.0, 1.0, 0.0), "young_modulus nan"),
        (lambda: Rectangle(0.02, (0.01, -0.01)), "thickness"),
        (lambda: Circle((0.02, 0.0)), "diameter"),
        (lambda: Uniform(1.0, 1.0, 0.0, 1.0), "section"),
        (
            lambda: Geometry(0.0, LEG.section),
            "length 0.0 must be above 0",
        ),
        (lambda: Geometry(math.inf, LEG.section), "finite"),
        (lambda: slender(1), "nodes 1 must be at least 2"),
        (
            lambda: slender(pose=Pose(rotation=(0.0, math.nan, 0.0))),
            "a value is not finite",
        ),
        (lambda: Scheme(theta=0.4), "theta 0.4 must be within"),
        (lambda: Scheme(tolerance=-1.0), "tolerance -1.0"),
        (lambda: slender().step(math.nan), "step nan"),
        (lambda: slender().run(1e-3, -5), "samples 0 must divide steps -5"),
        (
            lambda: slender().step(1e-3, base=Pose((math.nan, 0.0, 0.0))),
            "a value is not finite",
        ),
        (lambda: Loads(moment=(math.inf, 0.0, 0.0)), "a value is not finite"),
        (
            lambda: slender().natural_frequencies(
                1, Loads(follower=(1.0, 0.0, 0.0))
            ),
            "follower",
        ),
        (lambda: slender(tendons=[RodTendon((0.1,))]), "offset"),
        (lambda: RodTendon((0.0, 0.1), stiffness=-1.0), "stiffness -1.0"),
        (
            lambda: slender().solve_static(Loads(pull=(1.0,))),
            r"pull: shape \(1,\), expected \(0,\)",
        ),
        (
            lambda: slender(tendons=[RodTendon((0.0, 0.1))]).energy(
                Loads(pull=(-1.0,))
            ),
            "pull .* must not be below 0",
        ),
        (
            lambda: slender(tendons=[RodTendon((0.0, 0.1))]).energy(
                Loads(length=(0.9,))
            ),
            "length needs a tendon's stiffness",
        ),
        (lambda: slender().energy(Loads(line=(1.0,) * 4)), "line"),
        (
            lambda: Plane((0.0,) * 3, (0.0,) * 3, 1.0),
            "normal .* must not be 0",
        ),
        (lambda: StaticSettings(side=0), "side 0"),
        (lambda: StaticSettings(tolerance=-1.0), r"tolerances \(-1.0, 1e-06\)"),
        (
            lambda: slender().solve_static(
                Loads(moment=(1.0, 0.0, 0.0)), StaticSettings(stay_stable=True)
            ),
            "stay_stable needs",
        ),
    ],
)
def test_invalid_arguments_are_refused_by_name(act, rule):
    with pytest.raises(RodError, match=rule):
        act()
