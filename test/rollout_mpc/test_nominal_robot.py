"""Rollouts of the nominal robot against the simulated robot, step by step."""

import dataclasses

import numpy as np
import pytest
from nominal_walk import torso_of

from slot_core.dynamics.servo import read_servo
from slot_core.legs.tabulated_robot import TabulatedRobot
from slot_core.robot import read_robot
from slot_core.rollout_mpc.nominal_robot import NominalRobot, nominal_scene
from slot_core.rollout_mpc.settings import read_rollout_mpc

ROBOT, SETTINGS = read_robot(), read_rollout_mpc().nominal
DT, STAGES = 0.033, 22
STANDING = np.array([0.02, -0.01, 0.4, 0.1, -0.2, 0.055, 0, 0, 0, 0, 0, 0])


def plans(count, seed=0):
    """Angles (count, STAGES + 1, 4) that wander about those of a standing robot."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(0.0, 0.1, (count, STAGES + 1, 4))
    return np.clip(1.3 + np.cumsum(steps, axis=1), 0.0, ROBOT.tendon.angle_max)


@pytest.fixture
def model():
    return NominalRobot(ROBOT, SETTINGS, DT)


def test_a_rollout_is_the_motion_of_the_simulated_robot(model):
    plan = plans(1)[0]
    start = model.at_rest(STANDING, plan[0])
    found = model.roll_out(start, plan[None])
    step = DT / (SETTINGS.cycles * SETTINGS.steps)
    robot = TabulatedRobot(ROBOT, nominal_scene(SETTINGS, step), read_servo())
    robot.state.buffer[:], robot.feet.side_rate[:] = start
    for k in range(STAGES):
        for c in range(SETTINGS.cycles):
            share = c / SETTINGS.cycles
            robot.advance(SETTINGS.steps, plan[k] + share * (plan[k + 1] - plan[k]))
        np.testing.assert_allclose(
            found.force[0, k], robot.ground_force, rtol=0, atol=1e-9
        )
        pose = np.concatenate([robot.rpy, robot.position])
        np.testing.assert_allclose(
            found.pose[0, k], pose, rtol=0, atol=1e-11
        )  # rounding


def test_plans_of_one_call_do_not_affect_one_another(model):
    several, start = plans(5), model.at_rest(STANDING, np.full(4, 1.3))
    together = model.roll_out(start, several)
    for k, plan in enumerate(several):
        np.testing.assert_array_equal(
            model.roll_out(start, plan[None]).pose[0], together.pose[k]
        )


def test_a_measured_state_has_the_torso_of_the_estimate_and_the_legs_of_the_model(
    model,
):
    start = model.at_rest(STANDING, np.full(4, 1.3))
    moved = np.array(
        [0.1, -0.2, 3.0, 1.0, 2.0, 0.05, 0.3, 0.2, -0.1, 0.04, 0.03, -0.02]
    )
    found = model.measured(start, moved)
    torso = model.robot.state
    torso.buffer[:] = found.buffer
    assert torso.tendon_angle == pytest.approx(np.full(4, 1.3), abs=0.05)  # it sags
    np.testing.assert_allclose(torso_of(model, found), moved, rtol=0, atol=1e-14)


def test_a_rollout_that_diverges_is_nan_and_spoils_no_other(model):
    start, plan = model.at_rest(STANDING, np.full(4, 1.3)), plans(1)
    good = model.roll_out(start, plan).pose
    over = STANDING.copy()
    over[1] = 1.2  # rad, beyond 60 deg
    found = model.roll_out(model.measured(start, over), plan)
    assert np.isnan(found.pose).all()
    assert np.isnan(found.force).all()
    np.testing.assert_array_equal(model.roll_out(start, plan).pose, good)


def test_a_wrench_moves_the_robot_and_none_brings_it_back(model):
    start, plan = (
        model.at_rest(STANDING, np.full(4, 1.3)),
        np.full((1, STAGES + 1, 4), 1.3),
    )
    free = model.roll_out(start, plan).pose[0, -1]
    model.set_wrench(np.array([-3.0, 0.1, 0.0]), 0.0)
    loaded = model.roll_out(start, plan).pose[0, -1]
    assert loaded[5] < free[5] - 1e-3  # it sinks
    assert loaded[0] > free[0] + 1e-3  # and rolls to the right: y down
    model.set_wrench(np.zeros(3), 0.0)
    np.testing.assert_array_equal(model.roll_out(start, plan).pose[0, -1], free)


def test_more_steps_converge(model):
    """The error of the steps of the plan is below the sensors' noise of the place, 1 mm."""
    plan, ends = plans(1), []
    for steps in (SETTINGS.steps, 16):
        fine = NominalRobot(ROBOT, dataclasses.replace(SETTINGS, steps=steps), DT)
        ends.append(fine.roll_out(fine.at_rest(STANDING, plan[0, 0]), plan).pose[0, -1])
    assert np.abs(ends[0] - ends[1])[3:].max() < 2e-3
