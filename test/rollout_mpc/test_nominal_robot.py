"""Rollouts of the nominal robot against the simulated robot, step by step."""

import numpy as np
import pytest
from nominal_walk import ROBOT, SETTINGS, torso_of

from slot_core.control.force_map import read_springs
from slot_core.dynamics.servo import read_servo
from slot_core.legs.tabulated_robot import TabulatedRobot
from slot_core.rollout_mpc.nominal_robot import NominalRobot, nominal_scene

NOMINAL, DT, STAGES = SETTINGS.nominal, 0.033, 22
STANDING = np.array([0.02, -0.01, 0.4, 0.1, -0.2, 0.055, 0, 0, 0, 0, 0, 0])


def plans(count, seed=0):
    """Angles (count, STAGES + 1, 4) that wander about those of a standing robot."""
    steps = np.random.default_rng(seed).normal(0.0, 0.1, (count, STAGES + 1, 4))
    return np.clip(1.3 + np.cumsum(steps, axis=1), 0.0, ROBOT.tendon.angle_max)


@pytest.fixture
def model():
    return NominalRobot(ROBOT, NOMINAL, DT)


def test_a_rollout_is_the_motion_of_the_simulated_robot(model):
    """Each of the plans of a call, without effect on the others; on a slope."""
    model.gravity = gravity = np.array([-0.5, 0.3, -9.8])
    several = plans(3)
    start = model.at_rest(STANDING, several[0, 0])
    found = model.roll_out(start, several)
    step = DT / (NOMINAL.cycles * NOMINAL.steps)
    robot = TabulatedRobot(ROBOT, nominal_scene(NOMINAL, step), read_servo())
    robot.model.gravity[:] = gravity
    robot.legs.table[:] = model.robot.legs.table
    for plan, pose, force in zip(several, found.pose, found.force):
        robot.state.buffer[:] = start
        for k in range(STAGES):
            for share in np.arange(NOMINAL.cycles) / NOMINAL.cycles:
                angle = plan[k] + share * (plan[k + 1] - plan[k])
                robot.advance(NOMINAL.steps, angle)
            np.testing.assert_allclose(
                force[k], robot.ground_force, rtol=0, atol=1e-9
            )
            # rounding
            there = [*robot.rpy, *robot.position]
            np.testing.assert_allclose(pose[k], there, rtol=0, atol=1e-11)


def test_a_measured_state_has_the_torso_of_the_estimate_and_the_legs_of_the_model(
    model,
):
    start = model.at_rest(STANDING, np.full(4, 1.3))
    moved = np.array(
        [0.1, -0.2, 3, 1, 2, 0.05, 0.3, 0.2, -0.1, 0.04, 0.03, -0.02]
    )
    torso = torso_of(model, model.measured(start, moved))
    np.testing.assert_allclose(torso, moved, rtol=0, atol=1e-14)
    angle = model.robot.state.tendon_angle
    assert angle == pytest.approx(np.full(4, 1.3), abs=0.05)  # it sags


def test_a_rollout_that_diverges_is_nan_and_spoils_no_other(model):
    start, plan = model.at_rest(STANDING, np.full(4, 1.3)), plans(1)
    good = model.roll_out(start, plan).pose
    # rad, beyond 60 deg
    over = model.measured(start, STANDING + 1.2 * np.eye(12)[1])
    found = model.roll_out(over, plan)
    assert np.isnan([*found.pose.flat, *found.force.flat]).all()
    np.testing.assert_array_equal(model.roll_out(start, plan).pose, good)


@pytest.mark.parametrize("ratio", [0.65, 1.5])
def test_legs_of_another_stiffness_hold_the_torso_where_the_gait_says(
    model, ratio
):
    """Within 3 mm: the servos sag, and the feet stick."""
    model.stiffness = ratio
    height, springs = np.full(4, 0.045), read_springs()
    angle = springs.angle(np.full(4, ROBOT.weight / 4), height, ratio)
    start = model.at_rest(0.045 * np.eye(12)[5], angle)
    pose = model.roll_out(start, np.tile(angle, (1, 61, 1))).pose[0, -1]
    assert pose[5] == pytest.approx(0.045, abs=3e-3)
    model.stiffness = 1.0
    pose = model.roll_out(start, np.tile(angle, (1, 61, 1))).pose[0, -1]
    assert abs(pose[5] - 0.045) > 8e-3
