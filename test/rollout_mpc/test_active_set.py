"""Dual active-set method against Clarabel: random, degenerate and infeasible problems."""

import clarabel
import numpy as np
import pytest
from scipy import sparse

from slot_core.rollout_mpc.active_set import ActiveSet

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
