"""Stiffness of a leg whose foot sticks: an independent energy, unit loads, the static leg."""

import numpy as np
import pytest
from leg_energy import chain_strains, elastic_energy
from scipy.spatial.transform import Rotation
from test_leg_map import pulled

from slot_core.robot import read_robot
from slot_lab.leg_tests.leg_map import StickingLeg, foot_stiffness

ROBOT = read_robot()


class Standing:
    """Energy of a standing leg as a chain of frames whose contact points stay in contact."""

    def __init__(self, model, node, angle, height):
        self.model, self.angle, self.height = model, angle, height
        self.node = np.column_stack(
            [node[:, 0], np.zeros(len(node)), node[:, 1]]
        )
        self.director = np.tile([0.0, -1.0, 0.0], (len(node) - 1, 1))
        self.corner = self.corners(self.node, self.director)
        self.touching = height + self.corner[:, 2] < 0.0

    def corners(self, node, director):
        """(P, 3) m, contact points, in the order of the floor's stiffness."""
        width = self.model.floor.half_width * director
        side = width[:, None, None] * [[-1.0], [1.0]]
        ends = np.stack([node[:-1], node[1:]], axis=1)[:, :, None]
        return (ends + side).reshape(-1, 3)

    def energy(self, move):
        """J; move: shift and turn of the clamp, shifts of the nodes behind, turns of segments."""
        floor, n = self.model.floor, len(self.node) - 1
        shift = np.vstack([move[:3], move[6 : 6 + 3 * n].reshape(-1, 3)])
        node, clamp = self.node + shift, Rotation.from_rotvec(move[3:6])
        found, directors = chain_strains(
            self.model.rod,
            clamp,
            self.node,
            self.director,
            node,
            move[6 + 3 * n :],
        )
        corner = self.corners(node, directors)
        slid = ((corner - self.corner)[:, :2] ** 2).sum(1)
        springs = (self.height + corner[:, 2]) ** 2 + floor.bristle * slid
        stored = (floor.stiffness * springs)[self.touching].sum() / 2
        weight = -self.model.gravity[2] * self.model.rod.mass @ node[:, 2]
        return stored + weight + elastic_energy(self.model, self.angle, *found)


def hessian(function, size, step):
    """Second differences (size, size) about zero."""
    found, move = np.zeros((size, size)), step * np.eye(size)
    for i in range(size):
        for j in range(i + 1):
            both, apart = move[i] + move[j], move[i] - move[j]
            value = (
                function(both)
                + function(-both)
                - function(apart)
                - function(-apart)
            )
            found[i, j] = found[j, i] = value / (4 * step * step)
    return found


@pytest.mark.parametrize(("angle_deg", "height"), [(63.0, 0.04), (100.0, 0.07)])
def test_stiffness_is_that_of_an_independent_energy(angle_deg, height):
    """The clamp's part of the Hessian less what the free nodes and segments give way."""
    angle, nodes = np.radians(angle_deg), 5
    here, leg = pulled(nodes, angle, height)[1], StickingLeg(ROBOT, nodes)
    chain = Standing(leg.model, here.node, angle, height)
    whole = hessian(chain.energy, 6 + 4 * (nodes - 1), 1e-5)
    free = whole[6:, 6:]
    expected = whole[:6, :6] - whole[:6, 6:] @ np.linalg.solve(
        free, whole[6:, :6]
    )
    assert np.linalg.eigvalsh(free).min() > 0.0
    found = leg.stiffness(here.node, angle, height)
    # Rounding of an energy of some 1e-1 J over squared steps of 1e-5 leaves 1e-6 N/m in terms of up
    # to 1e5 N/m; the differences neglect the fourth derivative.
    np.testing.assert_allclose(
        found[:3, :3], expected[:3, :3], rtol=1e-4, atol=0.02
    )
    np.testing.assert_allclose(found[3:], expected[3:], rtol=1e-3, atol=2e-3)


def test_stiffness_over_a_foots_displacements_is_that_of_the_clamp_moved_about_it():
    """Energy of finite motions: the clamp shifts back, and turns back about the foot."""
    angle, height = np.radians(90.0), 0.064
    here = pulled(31, angle, height)[1]
    held = StickingLeg(ROBOT, 31).stiffness(here.node, angle, height)
    found = foot_stiffness(held, here.contact_x)
    foot, small = np.array([here.contact_x, 0.0, -height]), 1e-6
    for way in np.vstack(
        [np.eye(3), np.random.default_rng(1).normal(size=(3, 3))]
    ):
        xi, y, phi = small * way
        back = Rotation.from_rotvec([0.0, 0.0, -phi])
        shift = foot - back.apply(foot) - [xi, y, 0.0]
        move = np.concatenate([shift, back.as_rotvec()]) / small
        assert way @ found @ way == pytest.approx(move @ held @ move, rel=1e-5)
    # a foot that may turn leaves a fifth of the stiffness sideways
    free = found[1, 1] - found[1, 2] ** 2 / found[2, 2]
    assert 0.1 < free / found[1, 1] < 0.3
