"""Shapes of the robot for viewers: where they are, how long, in which colour."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from synthetic_walk import NODES, ROBOT, Walk, leg_nodes

from slot_core.drawing import shapes

WALK = Walk(roll=0.1)
TURN = Rotation.from_euler("xyz", [0.2, -0.1, 0.9])
PLACE = np.array([0.3, -0.2, 0.08])


STILL = np.array([0.0, 0.0, 0.0, 1.0])
NONE = np.zeros((4, 0, 3))


@pytest.fixture
def legs():
    """Bent legs of a robot that stands still, without directors."""
    return shapes.bent_legs(leg_nodes(WALK, 0.2), NONE, STILL, ROBOT)


def straight_legs(turn):
    """Four equal straight legs along x, twisted by angles (5,) (rad) at their nodes."""
    nodes, middle = np.zeros((5, 3)), (turn[1:] + turn[:-1]) / 2
    nodes[:, 0] = np.linspace(0.0, 0.2, 5)
    # To the right, -y, turned about x.
    directors = -np.column_stack([np.zeros(4), np.cos(middle), np.sin(middle)])
    return shapes.Legs(np.tile(nodes, (4, 1, 1)), np.tile(directors, (4, 1, 1)))


def test_stress_free_legs_start_at_the_clamps_and_end_at_the_feet():
    nodes = shapes.natural_legs(PLACE, TURN.as_quat(), ROBOT, 30).nodes
    assert np.allclose(nodes[:, 0], PLACE + TURN.apply(ROBOT.clamps))
    assert np.allclose(nodes[:, -1], PLACE + TURN.apply(ROBOT.feet))
    length = np.linalg.norm(np.diff(nodes, axis=1), axis=2).sum(axis=1)
    assert np.allclose(length, ROBOT.leg.arc_length(), rtol=1e-3)  # 29 chords of an arc


def test_a_straight_leg_turned_about_itself_by_90_deg_is_wide_upward_and_thick_sideways():
    bars = shapes.leg_bars(straight_legs(np.full(5, np.pi / 2)), ROBOT)
    for corners in bars.corners:
        assert np.allclose(corners[..., 0], np.linspace(0.0, 0.2, 5)[:, None])
        # 13.5 mm thick at the clamp, 3.5 mm at the tip
        half = np.array([6.75, 5.5, 4.25, 3.0, 1.75])[:, None] * 1e-3
        assert np.allclose(
            corners[..., 1], half * [-1, -1, 1, 1]
        )  # its lower side faces left
        assert np.allclose(
            corners[..., 2], 0.01 * np.array([1, -1, -1, 1])
        )  # 20 mm wide


def test_without_directors_a_leg_is_wide_across_the_plane_of_its_azimuth():
    legs = shapes.natural_legs(PLACE, TURN.as_quat(), ROBOT, NODES)
    right = np.cross(ROBOT.outward, [0.0, 0.0, 1.0])
    assert np.allclose(TURN.inv().apply(legs.directors[:, 7]), right)
    corners = TURN.inv().apply(
        (shapes.leg_bars(legs, ROBOT).corners - PLACE).reshape(-1, 3)
    )
    corners = corners.reshape(4, -1, 3) - ROBOT.clamps[:, None]
    across = np.einsum("lni,li->ln", corners, right)
    assert np.allclose(np.abs(across), 0.01)  # in front of and behind the plane


def test_a_tendon_runs_below_its_leg_at_the_offset_up_to_the_anchor():
    legs = shapes.natural_legs(PLACE, TURN.as_quat(), ROBOT, NODES)
    drawn = shapes.tendon_strips(legs, np.zeros(4), ROBOT, 1.0).points
    apart = TURN.inv().apply((drawn - legs.nodes[:, : drawn.shape[1]]).reshape(-1, 3))
    assert np.allclose(np.linalg.norm(apart, axis=1), ROBOT.tendon.offset)
    assert np.all(
        apart[:, 2] < -0.8 * ROBOT.tendon.offset
    )  # below in the torso's frame
    along = np.linalg.norm(np.diff(drawn, axis=1), axis=2).sum(axis=1)
    share = along / ROBOT.leg.arc_length()
    # to one node; a line below a leg that bends downwards is shorter than the leg
    assert np.allclose(share, ROBOT.tendon.end_fraction, atol=1.5 / NODES)


def test_a_force_is_an_arrow_to_scale_from_the_tip_and_a_small_one_is_not_drawn(legs):
    force = np.array([[0, 0, 5.0], [1.0, 0, 2.0], [0, 0, 0.1], [0, 0, 0.0]])
    tips = legs.nodes[:, -1]
    drawn = shapes.force_arrows(tips, force, shapes.LEG_COLOURS)
    assert np.array_equal(drawn.tail, tips[:2])
    assert np.allclose(drawn.vector, shapes.FORCE_SCALE * force[:2])
    assert np.array_equal(drawn.colours, shapes.LEG_COLOURS[:2])
