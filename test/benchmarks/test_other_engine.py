"""The robot in MuJoCo against closed forms and the project's own laws."""

import numpy as np
import pytest

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import read_robot

mujoco = pytest.importorskip("mujoco", reason="needs scripts/setup --bench")

from benchmarks.robot import mujoco_robot  # noqa: E402 - they need MuJoCo

ROBOT = read_robot()


def simulator(**changes):
    scene = config.replace(
        read_scene("flat"), {"solver.legs": "spatial"} | changes
    )
    return mujoco_robot.MujocoRobot(ROBOT, scene, read_servo())


def test_natural_legs_lie_on_the_natural_shape_and_weigh_what_the_robot_does():
    robot = simulator(**{"start.settle": 0.0, "start.height": 1.0})
    arm = robot.nodes - robot.position - ROBOT.clamps[:, None]
    x = np.einsum("lni,li->ln", arm, ROBOT.outward)
    drop = ROBOT.leg.shape(x) - ROBOT.leg.shape(0.0)
    # nodes are interpolated between 4001 points of the curve
    np.testing.assert_allclose(arm[..., 2], drop, atol=1e-6)
    np.testing.assert_allclose(x[:, -1], ROBOT.leg.reach, atol=1e-6)
    assert robot._model.body_subtreemass[0] == pytest.approx(
        ROBOT.mass, rel=1e-6
    )


def test_standing_feet_carry_the_weight_without_chatter():
    """Over 50 ms no force changes by more than 1 %; with stiffer contacts they did by a quarter."""
    robot = simulator(**{"solver.nodes": 10, "start.settle": 2.0})
    angle = np.radians(read_scene("flat").start.tendon_angle_deg)
    for _ in range(50):
        robot.advance(1, np.full(4, angle))
        np.testing.assert_allclose(
            robot.ground_force[:, 2], ROBOT.weight / 4, rtol=0.01
        )
