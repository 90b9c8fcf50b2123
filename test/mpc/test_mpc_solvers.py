"""Solver of the MPC on forces against an active-set method: random, hard, invalid problems."""

import copy
import dataclasses

import numpy as np
import pytest
from scipy import sparse

from benchmarks.mpc.cases import hard_cases, random_case, standing, torso
from benchmarks.mpc.cvxpy_reference import CvxpyReference
from benchmarks.mpc.oracle import optimum
from slot_core import config
from slot_core.control.policy import Status
from slot_core.mpc.force_mpc import ForceMpc
from slot_core.mpc.settings import read_mpc
from slot_core.mpc.solver import QpSolver
from slot_core.robot import read_robot

ROBOT = read_robot()
# no time budget: the tests must not depend on the load of the machine
SETTINGS = config.replace(read_mpc("force_mpc"), {"acceptance.time_budget": np.inf})
H = SETTINGS.horizon
# Where a limit is weakly active, an interior-point solution is off by about the root of its gap,
# 1e-5 N. An error of 1e-3 N does not matter to the robot.
TOLERANCE = 1e-3


def controller(**changes):
    others = {key.replace("__", "."): value for key, value in changes.items()}
    return ForceMpc(ROBOT, config.replace(SETTINGS, others), lambda: 0.0)


FOUND = {}  # first forces (4, 3) N of the optimum, by the problem


def exact(mpc):
    """First forces (4, 3) N of the optimum of the problem, by the active-set method."""
    qp = mpc.problem.qp
    parts = (qp.P.data, qp.c, qp.A.data, qp.b, qp.G.data, qp.h, qp.lower, qp.upper)
    key = tuple(np.asarray(part).tobytes() for part in parts)
    if key not in FOUND:
        FOUND[key] = optimum(qp)[0]
    return FOUND[key]


def test_oracle_and_cvxpy_reference_have_the_same_forces():
    mpc, rng = controller(), np.random.default_rng(2)
    reference = CvxpyReference(ROBOT, SETTINGS)
    for case in [
        *(random_case(rng, H + 1) for _ in range(5)),
        hard_cases(H + 1)["a leg swings"],
    ]:
        mpc.step(*case)
        force = reference.solve(case[0].state, case[1])
        # Clarabel's gap of 1e-11 has a root of 3e-6
        np.testing.assert_allclose(exact(mpc), force[0], atol=2e-5)


@pytest.mark.parametrize(
    ("count", "factor", "changes"),
    [
        (25, 1, {}),
        (3, 1, {"horizon": 1}),
        (3, 1, {"horizon": 2}),
        (3, 1, {"horizon": 40}),
        # A condition number of a tenth of `condition_max`. The error of the forces is inverse to
        # the root of their weight: sqrt(2 / 0.05) = 6
        (5, 6, {"weights__force": (0.05,) * 3}),
    ],
)
def test_first_forces_are_the_optimum_of_random_problems(count, factor, changes):
    mpc, rng = controller(**changes), np.random.default_rng(5)
    for _ in range(count):
        result = mpc.step(*random_case(rng, changes.get("horizon", H) + 1))
        assert result.status == Status.SOLVED
        np.testing.assert_allclose(
            result.force[0], exact(mpc), rtol=0, atol=factor * TOLERANCE
        )


@pytest.mark.parametrize("case", hard_cases(H + 1))
def test_hard_cases_give_the_optimum(case):
    mpc = controller()
    result = mpc.step(*hard_cases(H + 1)[case])
    assert result.status == Status.SOLVED
    assert result.report.violation <= SETTINGS.acceptance.violation_max
    np.testing.assert_allclose(result.force[0], exact(mpc), rtol=0, atol=TOLERANCE)


def test_forces_without_contact_friction_or_a_force_limit_are_zero():
    mpc, cases = controller(), hard_cases(H + 1)
    excluded = [
        mpc.step(*cases["flight"]).force,
        mpc.step(*cases["no friction"]).force[..., :2],
    ]
    result = controller(force_max=0.0).step(torso(), standing(H + 1))
    assert result.status == Status.SOLVED
    for force in (*excluded, result.force):
        assert np.abs(force[0]).max() < 1e-6  # N, of 5; roundoff and residual


def test_after_many_updates_the_solution_is_that_of_a_new_solver():
    used, rng = controller(), np.random.default_rng(9)
    for _ in range(200):
        used.step(*random_case(rng, H + 1))
    for case in [random_case(rng, H + 1), (torso(), standing(H + 1))]:
        fresh = controller().step(*case)
        np.testing.assert_allclose(used.step(*case).force, fresh.force, atol=TOLERANCE)


def test_a_failed_case_does_not_affect_the_next():
    mpc, limit = controller(), SETTINGS.acceptance.input_max
    good = random_case(np.random.default_rng(10), H + 1)
    for x in (
        torso(p=(0, 0, -1e3)),
        torso(p=(0, 0, limit)),
        torso(rpy=(limit, -limit, 0)),
    ):
        mpc.step(x, standing(H + 1))
        result = mpc.step(*good)
        assert result.status == Status.SOLVED
        np.testing.assert_allclose(result.force[0], exact(mpc), rtol=0, atol=TOLERANCE)


def test_equal_histories_give_bit_equal_forces():
    def run():
        mpc, rng = controller(), np.random.default_rng(11)
        return np.array([mpc.step(*random_case(rng, H + 1)).force for _ in range(20)])

    np.testing.assert_array_equal(run(), run())


def problem_of_standing():
    """A copy of the controller's problem for a standing robot, to be changed."""
    mpc = controller()
    mpc.step(torso(p=(0, 0, 0.03)), standing(H + 1))
    return copy.deepcopy(mpc.problem.qp)


def test_infeasible_limits_are_a_fault():
    qp = problem_of_standing()
    instance = QpSolver(qp, SETTINGS.solver)
    assert instance.solve().fault == ""
    qp.upper[3, 2] = -1.0  # below the lower limit of zero
    assert instance.solve().fault
    qp.upper[3, 2] = 1.0
    assert instance.solve().fault == ""


class Balanced:
    """The controller's problem with sum f_z = `force` (N) in every stage."""

    def __init__(self, force):
        qp = problem_of_standing()
        rows = np.zeros((H, qp.P.shape[0]))
        for k in range(H):
            rows[k, 24 * k + 2 : 24 * k + 12 : 3] = 1.0
        self.horizon, self.P, self.c, self.G, self.h = (
            qp.horizon,
            qp.P,
            qp.c,
            qp.G,
            qp.h,
        )
        self.A = sparse.vstack([qp.A, rows], format="csc")
        self.b = np.concatenate([qp.b.ravel(), np.full(H, force)])
        self.lower, self.upper = qp.lower, qp.upper


def test_equalities_beside_the_dynamics_are_satisfied():
    qp = Balanced(ROBOT.weight)
    found = QpSolver(qp, SETTINGS.solver).solve()
    assert found.fault == ""
    np.testing.assert_allclose(qp.A @ found.z, qp.b, atol=1e-6)  # N


def test_a_balance_above_the_force_limits_is_a_fault():
    qp = Balanced(4 * SETTINGS.force_max + 1.0)
    assert QpSolver(qp, SETTINGS.solver).solve().fault


@pytest.mark.parametrize("iterations", [1, 2])
def test_reaching_the_iteration_limit_is_a_fault(iterations):
    few = dataclasses.replace(SETTINGS.solver, iterations=iterations)
    found = QpSolver(problem_of_standing(), few).solve()
    assert found.fault
    assert "\n" not in found.fault
    assert found.iterations <= iterations


def test_a_nan_in_the_problem_gives_a_fault_or_a_nan_solution():
    qp = problem_of_standing()
    instance = QpSolver(qp, SETTINGS.solver)
    qp.b.ravel()[5] = np.nan  # the height at the end of the first stage
    found = instance.solve()
    assert found.fault or not np.isfinite(found.z).all()
