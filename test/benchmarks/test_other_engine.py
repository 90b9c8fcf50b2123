"""The robot in MuJoCo against closed forms and the project's own laws."""

import functools
import math

import numpy as np
import pytest
from numba import njit
from scipy.integrate import quad

from slot_core import config
from slot_core.dynamics.model import build_model
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo, spool_rate
from slot_core.robot import LEGS, read_robot
from slot_core.section import second_moment, torsion_constant

mujoco = pytest.importorskip("mujoco", reason="needs scripts/setup --bench")

from benchmarks.robot import mujoco_robot  # noqa: E402 - they need MuJoCo

ROBOT = read_robot()
LEG = ROBOT.leg
LENGTH = LEG.arc_length()
ABOVE = config.replace(
    read_scene("flat"),
    {"solver.legs": "spatial", "start.settle": 0.0, "start.height": 1.0},
)


def stiffness(s):
    """E I sideways and G J at arc length s, N m^2."""
    thick = LEG.thickness(s / LENGTH)
    bending = LEG.young_modulus * second_moment(thick, LEG.width)
    return bending, LEG.shear_modulus * torsion_constant(LEG.width, thick)


def arc_compliance(turn):
    """Sideways compliance of the tip of a leg bent to a circular arc of an angle `turn`, m/N.

    At the angle b from the tip, with the radius R: bending arm R sin b, twisting arm R (1 - cos b).
    """
    radius = LENGTH / turn

    def part(s):
        bending, torsion = stiffness(s)
        angle = (LENGTH - s) / radius
        arm, lever = radius * math.sin(angle), radius * (1 - math.cos(angle))
        return arm**2 / bending + lever**2 / torsion

    return quad(part, 0.0, LENGTH)[0]


def joints(kind, links):
    """Names of the joints of a kind in leg FL."""
    return [f"{LEGS[0]}{k}{kind}" for k in range(links)]


@functools.cache
def chain():
    """A robot in MuJoCo above the floor."""
    return mujoco_robot.MujocoRobot(ROBOT, ABOVE, read_servo())


def test_natural_legs_lie_on_the_natural_shape_and_weigh_what_the_robot_does():
    robot = chain()
    arm = robot.nodes - robot.position - ROBOT.clamps[:, None]
    x = np.einsum("lni,li->ln", arm, ROBOT.outward)
    drop = LEG.shape(x) - LEG.shape(0.0)
    # nodes are interpolated between 4001 points of the curve
    np.testing.assert_allclose(arm[..., 2], drop, atol=1e-6)
    np.testing.assert_allclose(x[:, -1], LEG.reach, atol=1e-6)
    assert robot._model.body_subtreemass[0] == pytest.approx(
        ROBOT.mass, rel=1e-6
    )


@pytest.mark.parametrize("turn_deg", [30.0, 120.0])
def test_chain_bent_to_a_circular_arc_has_the_sideways_compliance_of_the_unit_load_integral(
    turn_deg,
):
    """The compliance of the chain is the sum of (arm of a joint)^2 / stiffness over its joints."""
    fine = build_model(
        ROBOT, config.replace(ABOVE, {"solver.nodes": 46}), read_servo()
    )
    turn, rod = math.radians(turn_deg), fine.rod
    model = mujoco_robot.build(ROBOT, fine, mujoco_robot.STEP)
    step, data = np.diff(rod.arc), mujoco.MjData(model)
    # between middles of segments
    bent = -turn / LENGTH * (np.append(0.0, step[:-1]) + step) / 2
    for name, angle in zip(joints("turn", len(step)), bent - rod.rest_angle):
        data.joint(name).qpos[0] = angle
    mujoco.mj_forward(model, data)
    tip, rows = data.body(f"FL{len(step) - 1}"), np.zeros((3, model.nv))
    end = tip.xpos + tip.xmat.reshape(3, 3) @ [rod.rest_length[-1], 0.0, 0.0]
    mujoco.mj_jac(model, data, rows, None, end, tip.id)
    aside = np.array([-ROBOT.outward[0, 1], ROBOT.outward[0, 0], 0.0]) @ rows
    own = [
        model.joint(name)
        for kind in ("side", "twist")
        for name in joints(kind, len(step))
    ]
    found = sum(
        aside[joint.dofadr[0]] ** 2 / joint.stiffness[0] for joint in own
    )
    assert found == pytest.approx(arc_compliance(turn), rel=0.01)


def test_tendon_is_slack_until_the_spool_has_taken_up_its_slack():
    robot, model = chain(), build_model(ROBOT, ABOVE, read_servo())
    assert robot._slack == pytest.approx(ROBOT.tendon.slack, rel=1e-9)
    for extra in (-1e-4, 1e-4):
        # m, natural length of the tendon less what the spool has left
        robot._data.ctrl[:] = -extra
        mujoco.mj_forward(robot._model, robot._data)
        pull = max(0.0, extra * model.tendon.stiffness)
        np.testing.assert_allclose(robot.tension, pull, rtol=1e-9)


@njit
def own_rate(law, drive, error, torque, h):
    return spool_rate(law, drive, error, 0.0, torque, h)


def test_servo_and_friction_of_the_guide_are_the_projects():
    law, h = build_model(ROBOT, ABOVE, read_servo()).servo, 1e-3
    assert law.friction > 1.0
    cases = [
        (0.0, 0.01, 0.0),
        (2.0, 1.0, 0.7),
        (-1.0, -0.02, 0.5),
        (0.0, 0.044, 0.9),
    ]
    for (
        speed,
        error,
        torque,
    ) in cases:  # the last one stands still between the two loads
        expected = own_rate(law, np.array([0.0, speed, 0.0]), error, torque, h)
        found = mujoco_robot.motor_speed(
            law, np.array(speed), np.array(error), torque, h
        )
        assert float(found) == pytest.approx(expected, rel=1e-12)
    assert expected == 0.0


@pytest.mark.parametrize(
    "change",
    [{"model": "torque_speed"}, {"integral": 1.0}, {"backlash_deg": 1.0}],
)
def test_servo_that_is_not_modelled_is_refused(change):
    with pytest.raises(ValueError, match="pid without integral and backlash"):
        mujoco_robot.MujocoRobot(
            ROBOT, ABOVE, config.replace(read_servo(), change)
        )


def test_standing_feet_carry_the_weight_without_chatter():
    """Over 50 ms no force changes by more than 1 %; with stiffer contacts they did by a quarter."""
    scene = config.replace(
        read_scene("flat"),
        {"solver.legs": "spatial", "solver.nodes": 10, "start.settle": 2.0},
    )
    robot = mujoco_robot.MujocoRobot(ROBOT, scene, read_servo())
    found = []
    for _ in range(50):
        robot.advance(1, np.full(4, math.radians(scene.start.tendon_angle_deg)))
        found.append(robot.ground_force[:, 2])
    np.testing.assert_allclose(found, ROBOT.weight / 4, rtol=0.01)
