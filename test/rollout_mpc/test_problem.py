"""The step of the plan against a solution by Clarabel, and the errors against their definition."""

import cvxpy as cp
import numpy as np
import pytest
from nominal_walk import ROBOT, SETTINGS

from slot_core.rollout_mpc.problem import PlanProblem

ANGLE_MAX, DT = ROBOT.tendon.angle_max, 0.033
K = SETTINGS.stages


@pytest.fixture
def problem():
    return PlanProblem(SETTINGS, ANGLE_MAX, DT)


def reference_change(problem, error, slopes, deviation, nominal):
    """The step from its statement in `problem.py`, by another solver."""
    limits, cost = SETTINGS.limits, SETTINGS.cost
    delta = cp.Variable(len(slopes))
    basis = problem.basis.reshape(len(slopes), -1)
    change = cp.reshape(delta @ basis, (K + 1, 4), order="C")
    b = deviation + change
    mean = cp.sum(b, axis=0, keepdims=True) / (K + 1)
    swing = b - np.ones((K + 1, 1)) @ mean
    objective = (
        cp.sum_squares(error + delta @ slopes)
        + cp.sum_squares(delta) / cost.change**2
        + (K + 1) * cp.sum_squares(mean) / (K * cost.deviation**2)
        + cp.sum_squares(swing) / (K * cost.swing**2)
    )
    most = np.maximum(
        DT * limits.rate, np.abs(np.diff(nominal + deviation, axis=0))
    )
    within = [
        cp.abs(b) <= limits.deviation,
        nominal + b >= min(limits.angle_min, nominal.min()),
        nominal + b <= ANGLE_MAX,
        cp.abs(cp.diff(nominal + b, axis=0)) <= most,
    ]
    problem = cp.Problem(cp.Minimize(objective), within)
    problem.solve("CLARABEL", tol_gap_rel=1e-10)
    return change.value


@pytest.mark.parametrize("size", [0.1, 3.0, 30.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_step_is_the_minimum_within_its_limits(problem, seed, size):
    rng = np.random.default_rng(seed)
    nominal = np.clip(
        1.3 + np.cumsum(rng.normal(0, 0.2, (K + 1, 4)), axis=0), 0.2, 1.9
    )
    deviation = np.clip(
        np.cumsum(rng.normal(0, 0.05, (K + 1, 4)), axis=0), -0.4, 0.4
    )
    deviation = np.clip(nominal + deviation, 0.2, 2.0) - nominal
    error, slopes = size * rng.normal(size=6 * K), rng.normal(size=(20, 6 * K))
    found = problem.change(
        error, problem.linearised(slopes), deviation, nominal
    )
    wanted = reference_change(problem, error, slopes, deviation, nominal)
    np.testing.assert_allclose(found, wanted, rtol=0, atol=2e-5)  # rad
    after = nominal + deviation + found
    assert after.min() >= min(SETTINGS.limits.angle_min, nominal.min()) - 1e-6
    assert after.max() <= ANGLE_MAX + 1e-6


def test_the_errors_are_scaled_and_turned_into_the_heading(problem):
    pose, reference, cost = np.zeros((1, K, 6)), np.zeros((K, 6)), SETTINGS.cost
    # y, heading to the left
    pose[0, -1, [0, 2, 4]] = cost.tilt, 2 * np.pi + cost.yaw, cost.place
    error = problem.errors(pose, reference, np.pi / 2)[0].reshape(K, 6)
    assert error[-1] == pytest.approx(
        np.array([1.0, 0.0, 1.0, 1.0, 0.0, 0.0]) / np.sqrt(K), abs=1e-9
    )
    assert not error[:-1].any()


def test_a_reference_leads_by_its_reach_and_falls_behind_by_the_drift(problem):
    rows, stage = np.zeros((K + 2, 12)), np.arange(K + 2)
    rows[:, 3] = 0.1 + 0.05 * DT * stage  # a robot at zero is 0.1 m behind
    rows[:, 0] = np.where(stage % 2, 0.02, -0.02)
    drift, k = np.array([0.01, 0.0, 0.1]), stage[1:-1]
    pose = problem.reference(rows, np.zeros(3), drift, 0.001)
    assert pose[:, 3] == pytest.approx(
        SETTINGS.cost.reach + (0.05 - 0.01) * DT * k
    )
    assert pose[:, 2] == pytest.approx(-0.1 * DT * k)
    assert pose[:, 5] == pytest.approx(-0.001)
    assert pose[:, 0] == pytest.approx(rows[1 : K + 1, 0].mean())
