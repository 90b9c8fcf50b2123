"""The step of the plan against a solution by Clarabel, and the errors against their definition.

Dual active-set method against Clarabel: random, degenerate and infeasible problems.
"""

import clarabel
import cvxpy as cp
import numpy as np
import pytest
from scipy import sparse

from slot_core.robot import read_robot
from slot_core.rollout_mpc.active_set import ActiveSet
from slot_core.rollout_mpc.problem import PlanProblem
from slot_core.rollout_mpc.settings import read_rollout_mpc

SETTINGS = read_rollout_mpc()
ANGLE_MAX, DT = read_robot().tendon.angle_max, 0.033
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


N, ROWS, SLACK = 25, 170, 1e-9


def by_clarabel(inverse, gradient, rows, low, high):
    """Minimum by an interior-point method; None if it finds none."""
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_iter = False, 200
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-11
    found = clarabel.DefaultSolver(
        sparse.csc_matrix(np.triu(np.linalg.inv(inverse))),
        gradient,
        sparse.csc_matrix(np.vstack([rows, -rows])),
        np.concatenate([high, -low]),
        [clarabel.NonnegativeConeT(2 * len(rows))],
        settings,
    ).solve()
    return (
        np.array(found.x)
        if found.status == clarabel.SolverStatus.Solved
        else None
    )


def random_problem(seed, kind="plain"):
    """H^-1, g, A, low and high; limits of four variables each, as those of a plan.

    The limits of other kinds depend on one another.
    """
    rng = np.random.default_rng(seed)
    root, rows = rng.normal(size=(N, N)), np.zeros((ROWS, N))
    for row in rows:
        row[rng.choice(N, 4, replace=False)] = rng.random(4)
    low, high = -0.3 * rng.random(ROWS), 0.3 * rng.random(ROWS)
    if kind == "equal rows":
        rows[60:110] = rows[110:160]
    if kind == "one side is at the start":
        low[:80], high[60:150] = 0.0, 0.0
    if kind == "no room":
        low[:15] = high[:15] = 0.0
    if kind == "opposite rows":
        rows[60:110], low[60:110] = -rows[110:160], -high[110:160]
        high[60:110] = -low[110:160]
    inverse = np.linalg.inv(root @ root.T + 0.1 * np.eye(N))
    return inverse, 20.0 * rng.normal(size=N), rows, low, high


KINDS = [
    "plain",
    "equal rows",
    "one side is at the start",
    "no room",
    "opposite rows",
]


@pytest.mark.parametrize("kind", KINDS)
def test_the_minimum_is_that_of_an_interior_point_method(kind):
    """One solver for all problems: one does not affect the next."""
    solver = ActiveSet(N)
    for seed in range(20):
        parts = random_problem(seed, kind)
        found, wanted = solver.solve(*parts, SLACK), by_clarabel(*parts)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-5)
        *_, rows, low, high = parts
        assert (
            max((low - rows @ found).max(), (rows @ found - high).max())
            <= 2 * SLACK
        )
        np.testing.assert_array_equal(ActiveSet(N).solve(*parts, SLACK), found)


def test_limits_that_contradict_each_other_and_numbers_that_are_not_finite_have_no_minimum():
    inverse, gradient, rows, low, high = random_problem(0)
    solver, bad = ActiveSet(N), np.where(np.arange(N) == 3, np.nan, gradient)
    assert solver.solve(inverse, bad, rows, low, high, SLACK) is None
    bad = np.where(np.eye(N) == 1, np.inf, inverse)
    assert solver.solve(bad, gradient, rows, low, high, SLACK) is None
    rows[1], low[1], high[1] = rows[0], high[0] + 0.1, high[0] + 0.2
    assert solver.solve(inverse, gradient, rows, low, high, SLACK) is None
    with pytest.raises(ValueError, match="gradient"):
        solver.solve(inverse, gradient[1:], rows, low, high, SLACK)
