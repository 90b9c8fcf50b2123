"""Shapes of the robot for viewers: where they are, how long, in which colour."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_walk import NODES, ROBOT, Walk, leg_nodes

from slot_core import config
from slot_core.report import palette, shapes
from slot_core.robot import LEGS

WALK = Walk(roll=0.1)
TURN = Rotation.from_euler("xyz", [0.2, -0.1, 0.9])
PLACE = np.array([0.3, -0.2, 0.08])


@pytest.fixture
def nodes():
    return leg_nodes(WALK, 0.2)


def test_colours_are_those_of_the_palette():
    assert np.allclose(shapes.rgb("#FF8000"), [1.0, 128 / 255, 0.0])
    for leg, colour in zip(LEGS, shapes.LEG_COLOURS):
        assert np.allclose(colour, shapes.rgb(palette.LEG_COLOURS[leg]))


def test_edges_of_a_box_are_its_twelve_and_turn_with_it():
    size = np.array([1.0, 2.0, 4.0])
    drawn = shapes.box_edges(PLACE, TURN.as_quat(), size, shapes.SLACK)
    (points,) = TURN.inv().apply(drawn.points[0] - PLACE)[None]
    assert np.allclose(np.abs(points), size / 2)
    steps = np.diff(points, axis=0)
    assert np.all((np.abs(steps) > 1e-9).sum(axis=1) == 1)  # along an edge, never across a face
    middles = (points[1:] + points[:-1]) / 2
    assert len(np.unique(middles.round(9), axis=0)) == 12


def test_stress_free_legs_start_at_the_clamps_and_end_at_the_feet():
    nodes = shapes.natural_nodes(PLACE, TURN.as_quat(), ROBOT, 30)
    assert np.allclose(nodes[:, 0], PLACE + TURN.apply(ROBOT.clamps))
    assert np.allclose(nodes[:, -1], PLACE + TURN.apply(ROBOT.feet))
    length = np.linalg.norm(np.diff(nodes, axis=1), axis=2).sum(axis=1)
    assert np.allclose(length, ROBOT.leg.arc_length(), rtol=1e-3)  # 29 chords of an arc


def test_legs_are_drawn_through_their_nodes_and_pale_if_the_shape_is_not_known(nodes):
    assert shapes.leg_strips(nodes, ROBOT).points is nodes
    assert np.array_equal(shapes.leg_strips(nodes, ROBOT).colours, shapes.LEG_COLOURS)
    pale = shapes.leg_strips(nodes, ROBOT, known=False)
    assert np.array_equal(pale.colours, np.tile(shapes.SLACK, (4, 1)))


def test_a_tendon_runs_below_its_leg_at_the_offset_up_to_the_anchor():
    nodes = shapes.natural_nodes(PLACE, TURN.as_quat(), ROBOT, NODES)
    drawn = shapes.tendon_strips(nodes, TURN.as_quat(), np.zeros(4), ROBOT, 1.0).points
    apart = TURN.inv().apply((drawn - nodes[:, : drawn.shape[1]]).reshape(-1, 3))
    assert np.allclose(np.linalg.norm(apart, axis=1), ROBOT.tendon.offset)
    assert np.all(apart[:, 2] < -0.8 * ROBOT.tendon.offset)  # below in the torso's frame
    along = np.linalg.norm(np.diff(drawn, axis=1), axis=2).sum(axis=1)
    share = along / ROBOT.leg.arc_length()
    # to one node; a line below a leg that bends downwards is shorter than the leg
    assert np.allclose(share, ROBOT.tendon.end_fraction, atol=1.5 / NODES)


def test_a_straight_tendon_goes_from_the_pulley_to_the_anchor(nodes):
    robot = config.replace(ROBOT, {"tendon.routing": "straight"})
    still = np.array([0.0, 0.0, 0.0, 1.0])
    drawn = shapes.tendon_strips(nodes, still, np.zeros(4), robot, 1.0).points
    assert drawn.shape == (4, 2, 3)
    distance = np.linalg.norm(drawn[:, 0] - nodes[:, 0], axis=1)
    assert np.allclose(distance, robot.tendon.pulley_distance)
    assert np.allclose(drawn[:, 1], nodes[:, round(2 / 3 * (NODES - 1))])


def test_the_colour_of_a_tendon_goes_with_its_tension_up_to_the_largest(nodes):
    tension = np.array([0.0, 5.0, 10.0, 30.0])
    still = np.array([0.0, 0.0, 0.0, 1.0])
    colours = shapes.tendon_strips(nodes, still, tension, ROBOT, 10.0).colours
    middle = (shapes.SLACK + shapes.LOADED) / 2
    assert np.allclose(colours, [shapes.SLACK, middle, shapes.LOADED, shapes.LOADED])


def test_a_force_is_an_arrow_to_scale_from_the_tip_and_a_small_one_is_not_drawn(nodes):
    force = np.array([[0, 0, 5.0], [1.0, 0, 2.0], [0, 0, 0.1], [0, 0, 0.0]])
    drawn = shapes.force_arrows(nodes[:, -1], force, shapes.LEG_COLOURS)
    assert np.array_equal(drawn.tail, nodes[:2, -1])
    assert np.allclose(drawn.vector, shapes.FORCE_SCALE * force[:2])
    assert np.array_equal(drawn.colours, shapes.LEG_COLOURS[:2])
