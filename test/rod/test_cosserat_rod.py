"""Equilibria of the Cosserat rod against closed forms, published figures and collocation."""

import math

import numpy as np
import pytest
import rod_references as exact
from rod_references import THIN, THIN_MATERIAL, UNIT
from scipy.linalg import eig
from scipy.optimize import brentq
from scipy.special import ellipk

from benchmarks.rod.release import LEG, TPU
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

STRIP = Geometry(1.0, Rectangle(1.0, (THIN, THIN)))
# L = EI = rho A = 1, EI sideways 2, GJ 0.8; it stretches by 1e-6 under a unit force.
OBLONG = Geometry(1.0, Uniform(1e6, 1.0, 2.0, 0.8))


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
    tip, errors = exact.tip(UNIT, geometry, loads), []
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
        exact.collocation(TPU, geometry, loads),
        [],
        [],
    )
    for nodes in (31, 61):
        rod = CosseratRod(TPU, geometry, nodes)
        rod.solve_static(loads)
        errors.append(error(rod, wanted[:3]))
        turns.append(np.abs(rod.state.ends[1] - exact.axes(wanted[3:7])).max())
    # 7e-6 under its weight; the leg is four times as thick at its base
    assert errors[1] < 1e-5
    assert turns[1] < 2e-4
    # Third order gives 8; weights at nodes beside the curve leave a small term of second order.
    assert errors[0] / errors[1] > (3.5 if any(loads.gravity) else 6)


# Bathe and Bolourchi's bend, which leaves its plane; displacements of the Princeton beam.
PUBLISHED = [
    ((exact.BEND_MATERIAL, exact.BEND, 61), (0.0, force, 0.0), tip)
    for force, tip in exact.BEND_TIPS.items()
] + [
    (
        (exact.PRINCETON_MATERIAL, exact.PRINCETON),
        (
            0.0,
            exact.PRINCETON_FORCE * math.cos(math.radians(degrees)),
            exact.PRINCETON_FORCE * math.sin(math.radians(degrees)),
        ),
        tip,
    )
    for degrees, tip in exact.PRINCETON_TIPS.items()
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


@pytest.mark.parametrize(("tendons", "loads", "tip", "most"), exact.TENDON_TIPS)
def test_tips_of_tendon_robots_that_bend_under_their_weight(
    tendons, loads, tip, most
):
    rod = CosseratRod(*exact.TENDON_ROBOT, tendons=tendons)
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
    load = exact.LATERAL * math.sqrt(0.8)
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
        (slender, "force", exact.EULER, 1),
        (pinned_column, "force", math.pi**2, 1),
        (round_column, "force", exact.EULER, 2),
        (slender, "gravity", exact.GREENHILL, 1),
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
