"""The step of the plan against a solution by Clarabel, and the errors against their definition."""

import cvxpy as cp
import numpy as np
import pytest

from slot_core.robot import read_robot
from slot_core.rollout_mpc.problem import PlanProblem
from slot_core.rollout_mpc.settings import read_rollout_mpc

SETTINGS, ANGLE_MAX, DT = read_rollout_mpc(), read_robot().tendon.angle_max, 0.033
K = SETTINGS.stages


@pytest.fixture
def problem():
    return PlanProblem(SETTINGS, ANGLE_MAX, DT)


def case(seed, size):
    """Errors (6 K,), slopes (20, 6 K), deviations and angles (K + 1, 4), random."""
    rng = np.random.default_rng(seed)
    nominal = np.clip(1.3 + np.cumsum(rng.normal(0, 0.2, (K + 1, 4)), axis=0), 0.2, 1.9)
    deviation = np.clip(np.cumsum(rng.normal(0, 0.05, (K + 1, 4)), axis=0), -0.4, 0.4)
    deviation = np.clip(nominal + deviation, 0.2, 2.0) - nominal
    return (
        size * rng.normal(size=6 * K),
        rng.normal(size=(20, 6 * K)),
        deviation,
        nominal,
    )


def change_of(problem, error, slopes, deviation, nominal):
    """The step as the policy asks for it."""
    return problem.change(error, problem.linearised(slopes), deviation, nominal)


def reference_change(problem, error, slopes, deviation, nominal):
    """The step from its statement in `problem.py`, by another solver."""
    limits, cost = SETTINGS.limits, SETTINGS.cost
    delta = cp.Variable(len(slopes))
    change = cp.reshape(
        delta @ problem.basis.reshape(len(slopes), -1), (K + 1, 4), order="C"
    )
    b = deviation + change
    mean = cp.sum(b, axis=0, keepdims=True) / (K + 1)
    swing = b - np.ones((K + 1, 1)) @ mean
    objective = (
        cp.sum_squares(error + delta @ slopes) + cp.sum_squares(delta) / cost.change**2
    )
    objective += (K + 1) * cp.sum_squares(mean) / (K * cost.deviation**2)
    objective += cp.sum_squares(swing) / (K * cost.swing**2)
    low = min(limits.angle_min, nominal.min())
    rate = cp.abs(cp.diff(nominal + b, axis=0))
    within = [
        cp.abs(b) <= limits.deviation,
        nominal + b >= low,
        nominal + b <= ANGLE_MAX,
    ]
    most = np.maximum(DT * limits.rate, np.abs(np.diff(nominal + deviation, axis=0)))
    cp.Problem(cp.Minimize(objective), [*within, rate <= most]).solve(
        "CLARABEL", tol_gap_rel=1e-10
    )
    return change.value


@pytest.mark.parametrize("size", [0.1, 3.0, 30.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_step_is_the_minimum_within_its_limits(problem, seed, size):
    args = case(seed, size)
    found = change_of(problem, *args)
    np.testing.assert_allclose(
        found, reference_change(problem, *args), rtol=0, atol=2e-5
    )  # rad
    after = args[3] + args[2] + found
    assert after.min() >= min(SETTINGS.limits.angle_min, args[3].min()) - 1e-6
    assert after.max() <= ANGLE_MAX + 1e-6


def test_limits_are_active_in_the_large_cases(problem):
    """So that the comparison sees them."""
    error, slopes, deviation, nominal = case(0, 30.0)
    free = change_of(problem, error / 1e4, slopes, 0 * deviation, 0 * nominal + 1.2)
    assert np.abs(free).max() < 0.4
    b = deviation + change_of(problem, error, slopes, deviation, nominal)
    at_limit = np.isclose(np.abs(b), SETTINGS.limits.deviation, atol=1e-5)
    at_limit |= np.isclose(nominal + b, ANGLE_MAX, atol=1e-5)
    assert at_limit.sum() > 3


def test_the_errors_are_scaled_and_turned_into_the_heading(problem):
    pose, reference = np.zeros((1, K, 6)), np.zeros((K, 6))
    cost = SETTINGS.cost
    pose[0, -1, [0, 2, 4]] = (
        cost.tilt,
        2 * np.pi + cost.yaw,
        cost.place,
    )  # y, heading to the left
    error = problem.errors(pose, reference, np.pi / 2)[0].reshape(K, 6)
    assert error[-1] == pytest.approx(
        np.sqrt(1 / K) * np.array([1.0, 0.0, 1.0, 1.0, 0.0, 0.0]), abs=1e-9
    )
    assert not error[:-1].any()


def test_a_reference_leads_by_its_reach_and_falls_behind_by_the_drift(problem):
    rows = np.zeros((K + 2, 12))
    rows[:, 3] = 0.1 + 0.05 * DT * np.arange(K + 2)  # a robot at zero is 0.1 m behind
    rows[:, 0] = np.where(np.arange(K + 2) % 2, 0.02, -0.02)
    drift = np.array([0.01, 0.0, 0.1])
    pose = problem.reference(rows, np.zeros(3), drift, 0.001)
    k = np.arange(1, K + 1)
    wanted = SETTINGS.cost.reach + (0.05 - 0.01) * DT * k
    assert pose[:, 3] == pytest.approx(wanted)
    assert pose[:, 2] == pytest.approx(-0.1 * DT * k)
    assert pose[:, 5] == pytest.approx(-0.001)
    assert pose[:, 0] == pytest.approx(rows[1 : K + 1, 0].mean())
