"""MPC on forces against the matrix exponential and CVXPY; infeasible and invalid problems."""

import cvxpy
import numpy as np
import pytest
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from benchmarks.mpc.cases import hard_cases, random_case, standing, state, torso
from slot_core import config
from slot_core.control.policy import Status
from slot_core.mpc.force_mpc import ForceMpc
from slot_core.mpc.model import TorsoModel
from slot_core.mpc.settings import read_mpc
from slot_core.robot import GRAVITY, read_robot

ROBOT = read_robot()
# no time budget: the tests must not depend on the load of the machine
SETTINGS = config.replace(read_mpc("force_mpc"), {"acceptance.time_budget": np.inf})
H, F_MAX, DT = SETTINGS.horizon, SETTINGS.force_max, 0.033
HOVER = ROBOT.weight / 4
CASES = hard_cases(H + 1)
# 1000 m are far beyond what the reference's tolerance resolves
NEAR = [name for name in CASES if "1000 m" not in name]


def new_mpc(**changes):
    names = {name.replace("__", "."): value for name, value in changes.items()}
    return ForceMpc(ROBOT, config.replace(SETTINGS, names), lambda: 0.0)


def preview(**changes):
    return standing(H + 1, **{"normal_force": np.full((H + 1, 4), HOVER)} | changes)


def continuous(yaw, height):
    """A, B, g of x' = A x + B u + g, leg by leg from the Newton-Euler equations."""
    rotation = Rotation.from_euler("z", yaw).as_matrix()
    inertia = rotation @ ROBOT.inertia @ rotation.T
    a, b, g = np.zeros((12, 12)), np.zeros((12, 12)), np.zeros(12)
    a[:3, 6:9], a[3:6, 9:], g[11] = rotation.T, np.eye(3), -GRAVITY
    for leg, axis in np.ndindex(4, 3):
        arm = rotation @ ROBOT.feet[leg]
        arm[2] = -height
        b[6:9, 3 * leg + axis] = np.linalg.solve(
            inertia, np.cross(arm, np.eye(3)[axis])
        )
        b[9 + axis, 3 * leg + axis] = 1 / ROBOT.mass
    return a, b, g


def discrete(yaw, height, dt):
    """Exact zero-order hold by the matrix exponential of [[A, B, g], [0, 0, 0]]."""
    a, b, g = continuous(yaw, height)
    whole = np.zeros((25, 25))
    whole[:12] = np.column_stack([a, b, g])
    held = expm(dt * whole)
    return held[:12, :12], held[:12, 12:24], held[:12, 24]


def optimum(x0, ahead, horizon=H):
    """u (horizon, 12) and cost, by CVXPY and Clarabel."""
    a, b, g = discrete(x0[2], x0[5], ahead.dt)
    q, r = np.sqrt(SETTINGS.weights.q), np.sqrt(SETTINGS.weights.r)
    x, u = cvxpy.Variable((horizon + 1, 12)), cvxpy.Variable((horizon, 12))
    u_ref = np.zeros((horizon, 12))
    u_ref[:, 2::3] = ahead.normal_force[:horizon]
    mu_f_z = cvxpy.multiply(ahead.friction[:horizon], u[:, 2::3])
    all_constraints = [
        x[0] == x0,
        x[1:] == x[:-1] @ a.T + u @ b.T + np.tile(g, (horizon, 1)),
    ]
    all_constraints += [u[:, 2::3] >= 0, u[:, 2::3] <= F_MAX * ahead.contact[:horizon]]
    all_constraints += [
        cvxpy.abs(u[:, 0::3]) <= mu_f_z,
        cvxpy.abs(u[:, 1::3]) <= mu_f_z,
    ]
    error = (x[1:] - ahead.reference[1 : horizon + 1]) @ np.diag(q)
    cost = cvxpy.sum_squares(error) + cvxpy.sum_squares((u - u_ref) @ np.diag(r))
    problem = cvxpy.Problem(cvxpy.Minimize(cost), all_constraints)
    problem.solve(
        solver=cvxpy.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11
    )
    assert problem.status == cvxpy.OPTIMAL
    return u.value, problem.value


@pytest.mark.parametrize("yaw", [0.0, 0.3, -2.5])
@pytest.mark.parametrize(("height", "dt"), [(0.04, 0.033), (0.1, 0.005), (0.0, 0.1)])
def test_prediction_is_the_exact_zero_order_hold(yaw, height, dt):
    predicted = TorsoModel(ROBOT).predict(yaw, height, dt)
    a, b, drift = discrete(yaw, height, dt)
    # entries reach about 7; expm and the series differ by roundoff only
    np.testing.assert_allclose(predicted.a, a, atol=1e-13)
    np.testing.assert_allclose(predicted.b, b, atol=1e-13)
    np.testing.assert_allclose(predicted.drift, drift, atol=1e-13)


def test_first_forces_and_cost_are_the_optimum_of_the_documented_problem():
    # One controller for all cases: data left over from an earlier update would be detected.
    mpc, rng = new_mpc(), np.random.default_rng(4)
    cases = [
        *(CASES[name] for name in NEAR),
        *(random_case(rng, H + 1) for _ in range(30)),
    ]
    for known, ahead in cases:
        plan, (u, cost) = mpc.step(known, ahead), optimum(known.state, ahead)
        assert plan.status == Status.SOLVED
        # where a limit is weakly active, an interior-point solution at a gap of 1e-10 is off by
        # up to 1.3e-4 N in 414 such cases
        np.testing.assert_allclose(plan.force[0].ravel(), u[0], rtol=0, atol=3e-4)
        assert plan.report.cost == pytest.approx(
            cost, rel=1e-6, abs=1e-6
        )  # flat at the optimum


@pytest.mark.parametrize("horizon", [1, 2, 40])
def test_a_horizon_of_any_length_gives_the_optimum(horizon):
    mpc, rng = new_mpc(horizon=horizon), np.random.default_rng(5)
    for known, ahead in (random_case(rng, horizon + 1) for _ in range(3)):
        u, _ = optimum(known.state, ahead, horizon)
        force = mpc.step(known, ahead).force[0].ravel()
        np.testing.assert_allclose(force, u[0], rtol=0, atol=1e-3)


@pytest.mark.parametrize("name", CASES)
def test_the_forces_of_every_stage_are_within_their_limits(name):
    known, ahead = CASES[name]
    f = new_mpc().step(known, ahead).force
    limit = 1e-6  # N; the solver's absolute residual is 1e-8 in scaled units
    assert np.all(f[..., 2] >= -limit)
    assert np.all(f[..., 2] <= F_MAX * ahead.contact[:H] + limit)
    friction_limit = ahead.friction[:H, :, None] * f[..., 2:] + limit
    # a coefficient of 100 multiplies the residual of f_z
    assert np.all(np.abs(f[..., :2]) <= friction_limit + limit * ahead.friction.max())


def test_full_turns_of_the_reference_do_not_matter():
    known = torso(rpy=(0, 0, 3.1))
    near, far = (
        np.tile(state(rpy=(0, 0, 3.2 - 2 * np.pi * n)), (H + 1, 1)) for n in (0, 1)
    )
    mpc = new_mpc()
    a, b = (mpc.step(known, preview(reference=ref)).force[0] for ref in (near, far))
    np.testing.assert_allclose(a, b, atol=1e-6)  # solver tolerance
    assert np.abs(a[:, :2]).max() > 1e-3  # the yaw error is not zero


def test_a_preview_as_long_as_the_horizon_repeats_its_last_reference():
    reference = np.tile(state(), (H + 1, 1))
    reference[:, 5] = np.linspace(0.04, 0.06, H + 1)
    reference[H] = reference[H - 1]
    mpc = new_mpc()
    whole = mpc.step(torso(), preview(reference=reference)).force
    short = mpc.step(
        torso(),
        standing(H, normal_force=np.full((H, 4), HOVER), reference=reference[:H]),
    ).force
    np.testing.assert_allclose(whole, short, atol=1e-9)  # roundoff


def test_slacks_are_those_of_the_first_stage():
    contact = np.ones((H + 1, 4), dtype=bool)
    contact[0, 3] = False
    plan = new_mpc().step(torso(v=(0.05, 0, 0)), preview(contact=contact))
    f, bound, report = plan.force[0], np.array([F_MAX, F_MAX, F_MAX, 0.0]), plan.report
    np.testing.assert_allclose(report.slack_normal_min, f[:, 2])
    np.testing.assert_allclose(report.slack_normal_max, bound - f[:, 2])
    tangential = np.maximum(np.abs(f[:, 0]), np.abs(f[:, 1]))
    np.testing.assert_allclose(report.slack_friction, 0.4 * f[:, 2] - tangential)
    assert report.slack_total == pytest.approx(3 * F_MAX - ROBOT.mass * GRAVITY)


@pytest.mark.parametrize(
    "changes",
    [
        {"weights__force": (1e-8, 1e-8, 1e-8)},
        {  # the published scripts: Q / 1000 with 100 on p_z and R = 1e-8
            "weights__angle": (1e-4, 1e-4, 1e-4),
            "weights__position": (0.0, 0.0, 100.0),
            "weights__rate": (1e-5, 1e-5, 1e-5),
            "weights__velocity": (0.02, 1e-4, 0.0),
            "weights__force": (1e-8, 1e-8, 1e-8),
        },
    ],
)
def test_weights_that_make_the_problem_ill_conditioned_are_rejected(changes):
    with pytest.raises(
        config.ConfigError, match=r"weights.force.*condition number .* exceeds 1"
    ):
        new_mpc(**changes)


def test_condition_number_is_that_of_the_condensed_hessian():
    # one stage in closed form: H = B'QB + R with the matrices of the exponential
    _, b, _ = discrete(0.3, 0.1, 0.1)
    weights = SETTINGS.weights
    hessian = b.T @ np.diag(weights.q) @ b + np.diag(weights.r)
    bound = np.linalg.cond(hessian)
    new_mpc(horizon=1, acceptance__condition_max=bound * 1.001)
    with pytest.raises(config.ConfigError):
        new_mpc(horizon=1, acceptance__condition_max=bound * 0.999)


def test_forces_without_contact_friction_or_a_force_limit_are_zero():
    mpc = new_mpc()
    excluded = [
        mpc.step(*CASES["flight"]).force,
        mpc.step(*CASES["no friction"]).force[..., :2],
    ]
    result = new_mpc(force_max=0.0).step(torso(), standing(H + 1))
    assert result.status == Status.SOLVED
    for force in (*excluded, result.force):
        assert np.abs(force[0]).max() < 1e-6  # N, of 5; roundoff and residual


def test_after_many_updates_the_solution_is_that_of_a_new_solver():
    used, rng = new_mpc(), np.random.default_rng(9)
    for _ in range(200):
        used.step(*random_case(rng, H + 1))
    for case in [random_case(rng, H + 1), (torso(), standing(H + 1))]:
        fresh = new_mpc().step(*case)
        np.testing.assert_allclose(used.step(*case).force, fresh.force, atol=1e-3)


def test_a_failed_case_does_not_affect_the_next():
    mpc, limit = new_mpc(), SETTINGS.acceptance.input_max
    good = random_case(np.random.default_rng(10), H + 1)
    expected = new_mpc().step(*good).force[0]
    for x in (
        torso(p=(0, 0, -1e3)),
        torso(p=(0, 0, limit)),
        torso(rpy=(limit, -limit, 0)),
    ):
        mpc.step(x, standing(H + 1))
        result = mpc.step(*good)
        assert result.status == Status.SOLVED
        np.testing.assert_allclose(result.force[0], expected, rtol=0, atol=1e-3)


def test_infeasible_limits_are_a_fault_of_their_cycle_alone():
    mpc = new_mpc()
    mpc.step(torso(), preview())
    for force_max, solved in ((F_MAX, True), (-1.0, False), (1.0, True)):
        mpc.problem.right[-1] = force_max  # of the last stage; f_z >= 0
        assert (mpc.problem.solve().fault == "") == solved


def test_a_nan_in_the_problem_gives_a_fault_or_a_nan_solution():
    mpc = new_mpc()
    mpc.step(torso(), preview())
    mpc.problem.right[5] = np.nan  # the height at the end of the first stage
    found = mpc.problem.solve()
    assert found.fault or not np.isfinite(found.z).all()
