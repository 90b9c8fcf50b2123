"""Equilibria of the Cosserat rod against closed forms, published figures and collocation."""

import math

import numpy as np
import pytest
from rods import OBLONG, UNIT, slender
from scipy.optimize import brentq
from scipy.special import ellipk

from benchmarks.rod import exact
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import (
    PINNED,
    ROLLER,
    Circle,
    Geometry,
    Loads,
    Material,
    Pose,
    Rectangle,
    RodError,
    Scheme,
    Support,
    Uniform,
)
from slot_core.rod.statics import (
    Branch,
    EquilibriumError,
    StaticSettings,
    free_unknowns,
)


def place(rod):
    return np.array(rod.tip.position)


def error(rod, tip):
    """Distance of the tip from a place, over the length."""
    return math.dist(place(rod), tip) / rod.mesh.length


@pytest.mark.parametrize("p", [0.2, 1.0, 3.0, 10.0])
def test_cantilever_follows_the_elastica_to_third_order(p):
    errors, loads = [], Loads(force=(0.0, 0.0, p))
    modelled = exact.thin(loads)
    for nodes in (9, 17, 31):
        rod = slender(nodes)
        assert rod.solve_static(loads).branch is Branch.PRIMARY
        errors.append(math.dist(place(rod)[[0, 2]], modelled))
    # stretch of the modelled rod
    assert math.dist(exact.elastica(p), modelled) < 2e-6
    assert errors[2] < 2e-5  # 1.1e-5 at p = 10
    assert np.log(errors[0] / errors[2]) / np.log(30 / 8) > 2.9


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
    geometry = Geometry(exact.LEG.length, exact.LEG.section, curvature=3.0)
    wanted, errors, turns = (
        exact.collocation(exact.TPU, geometry, loads),
        [],
        [],
    )
    for nodes in (31, 61):
        rod = CosseratRod(exact.TPU, geometry, nodes)
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


def test_snap_through_is_an_error_with_the_last_load_factor():
    # rise 35 mm: it snaps before any unsymmetric buckling
    thickness, curvature = (0.03, 0.28)
    material = Material(12 / thickness**3, 4 / thickness**3, 1 / thickness, 0.0)
    geometry = Geometry(1.0, Rectangle(1.0, (thickness, thickness)), -curvature)
    pose = Pose(rotation=(0.0, -curvature / 2, 0.0))
    hinge = Support((True, True, True), (True, False, True))
    rod = CosseratRod(material, geometry, 17, base=hinge, tip=hinge, pose=pose)
    free = free_unknowns(rod.mesh)
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
    loads, small = Loads(force=(0.2, 1.0, 1.5)), 1e-5
    rod = CosseratRod(UNIT, OBLONG, 12, refined=False)
    rod.solve_static(loads)
    free, start = free_unknowns(rod.mesh), place(rod)
    inverse = np.linalg.inv(rod.tangent(loads)[np.ix_(free, free)])
    tip = [np.flatnonzero(free == 4 * rod.nodes + c)[0] for c in range(3)]
    for c, force in enumerate(np.array(loads.force) + small * np.eye(3)):
        rod.solve_static(Loads(force=tuple(force)))
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
            lambda: Geometry(0.0, exact.LEG.section),
            "length 0.0 must be above 0",
        ),
        (lambda: Geometry(math.inf, exact.LEG.section), "finite"),
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
        (lambda: StaticSettings(side=0), "side 0"),
        (lambda: StaticSettings(tolerance=-1.0), "tolerances -1.0"),
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
