"""MPC on tendon angles against CVXPY with Clarabel, written from the equations of its docstring."""

import dataclasses
import math

import cvxpy
import numpy as np
import pytest
from postures import CASES, DT, HOME, ROBOT, SPRINGS, H, preview, state

from slot_core.control.policy import TendonPlan
from slot_core.legs.leg_springs import LegSprings
from slot_core.legs.leg_table import LegTable
from slot_core.mpc.model import Horizon
from slot_core.mpc.posture_problem import PostureProblem
from slot_core.mpc.settings import read_mpc
from slot_core.robot import GRAVITY

SETTINGS = read_mpc()
OPTIONS = SETTINGS.posture
CORRECTION = math.radians(OPTIONS.correction_max_deg)
ANGLE_MAX = ROBOT.tendon.angle_max


def follow(problem):
    """Command the plan of the problem's solution."""
    angle, force = problem.plan(problem.solve().z)
    problem.follow(TendonPlan(angle, np.zeros(4), force))


class Written:
    """The problem as the docstring writes it, leg by leg and stage by stage."""

    def __init__(self, ahead, options=OPTIONS):
        self.o, self.angle = options, ahead.tendon_angle[:H]
        self.posture = ahead.reference[:H][:, [5, 0, 1]]
        self.force = ahead.normal_force[:H]
        self.legs = [self.leg_row(k) for k in range(H)]

    def leg_row(self, k):
        """Levers (3, 4), dh/dq (4, 3), F_theta (4,) and F_h (4,) at stage k."""
        z, roll, pitch = self.posture[k]
        height = ROBOT.clamp_heights(z, roll, pitch)
        leg = SPRINGS.at(self.angle[k], height)
        out = [(math.cos(a), math.sin(a)) for a in ROBOT.azimuth]
        levers, rise = np.zeros((3, 4)), np.zeros((4, 3))
        for i, (x, y, _) in enumerate(ROBOT.clamps):
            x_c, y_c = x + leg.contact[i] * out[i][0], y + leg.contact[i] * out[i][1]
            levers[:, i], rise[i] = (1.0, y_c, -x_c), (1.0, y, -x)
        return levers, rise, leg.slope, leg.stiffness

    def error(self, k, disturbance):
        """A, B and e + d of stage k."""
        levers, rise, slope, stiffness = self.legs[k]
        a = sum(np.outer(levers[:, i], stiffness[i] * rise[i]) for i in range(4))
        lacking = levers @ self.force[k] - [ROBOT.weight, 0.0, 0.0] + disturbance
        return a, levers * slope, lacking

    def optimum(self, q_0, a_0, u_before, disturbance):
        """u (H, 4) rad of the optimum; q_0 (3,) and a_0 (4,) as deviations."""
        o = self.o
        q, a = cvxpy.Variable((H + 1, 3)), cvxpy.Variable((H + 1, 4))
        u, s = cvxpy.Variable((H, 4)), cvxpy.Variable(H)
        limits = [q[0] == q_0, a[0] == a_0, s >= 0, cvxpy.abs(u) <= CORRECTION]
        limits += [self.angle + u >= 0.0, self.angle + u <= ANGLE_MAX]
        _, b, lacking = self.error(0, disturbance)
        balance = np.clip(-np.linalg.pinv(b) @ lacking, -CORRECTION, CORRECTION)
        weights = np.sqrt([o.height, o.tilt, o.tilt])
        cost = o.slack * (cvxpy.sum(s) + cvxpy.sum_squares(s) / 2)
        for k in range(H):
            a_k, b_k, lacking = self.error(k, disturbance)
            inverse = np.linalg.inv(a_k)

            def speed(n, inverse=inverse, b_k=b_k, lacking=lacking):
                return (-q[n] - inverse @ (b_k @ a[n] + lacking)) / o.settling

            limits += [
                q[k + 1] == q[k] + DT / 2 * (speed(k) + speed(k + 1)),
                a[k + 1] == a[k] + DT / 2 * ((u[k] - a[k]) + (u[k] - a[k + 1])) / o.lag,
            ]
            n = min(k + 1, H - 1)
            _, rise, slope, stiffness = self.legs[n]
            force = cvxpy.multiply(slope, a[k + 1]) + cvxpy.multiply(stiffness, rise @ q[k + 1])
            limits.append(self.force[n] + force >= -s[k])
            cost += cvxpy.sum_squares(cvxpy.multiply(weights, q[k + 1])) / 2
            cost += o.angle * cvxpy.sum_squares(u[k] - balance) / 2
            cost += o.change * cvxpy.sum_squares(u[k] - (u[k - 1] if k else u_before)) / 2
        problem = cvxpy.Problem(cvxpy.Minimize(cost), limits)
        problem.solve(solver=cvxpy.CLARABEL, tol_gap_abs=1e-11, tol_gap_rel=1e-11, tol_feas=1e-11)
        assert problem.status == cvxpy.OPTIMAL
        return u.value


def beyond_tolerance(x, ahead):
    """Error (3,) of the posture beyond the tolerance."""
    error = x[[5, 0, 1]] - ahead.reference[0, [5, 0, 1]]
    free = [OPTIONS.height_tolerance, OPTIONS.tilt_tolerance, OPTIONS.tilt_tolerance]
    return error - np.clip(error, np.negative(free), free)


def horizon_of(ahead):
    """Limits and targets as the controller reads them."""
    force = np.zeros((H, 4, 3))
    force[..., 2] = ahead.normal_force[:H]
    contact = ahead.contact[:H].astype(float)
    return Horizon(SETTINGS.force_max * contact, ahead.friction[:H], force, ahead.reference[1:])


@pytest.mark.parametrize("case", CASES)
def test_the_first_angles_are_the_optimum_of_the_documented_problem(case):
    x, ahead = CASES[case]
    problem = PostureProblem(ROBOT, SPRINGS, OPTIONS, H)
    problem.update(x, ahead, horizon_of(ahead))
    found = problem.solve()
    assert found.fault == ""
    u = Written(ahead).optimum(beyond_tolerance(x, ahead), np.zeros(4), np.zeros(4), np.zeros(3))
    np.testing.assert_allclose(found.z[: 4 * H].reshape(H, 4), u, rtol=0, atol=1e-5)


def test_later_ticks_are_the_optimum_with_lagging_servos_and_the_disturbance():
    """The angles follow their commands by (1 - exp(-dt / lag)) of the difference in each tick."""
    problem, rng = PostureProblem(ROBOT, SPRINGS, OPTIONS, H), np.random.default_rng(3)
    spool = command = preview().tendon_angle[0]
    share = -math.expm1(-DT / OPTIONS.lag)
    for tick in range(12):
        x, ahead = state(0.037, 0.03, -0.02) + 0.002 * rng.normal(size=12), preview(tick=tick)
        problem.update(x, ahead, horizon_of(ahead))
        u = problem.solve().z[: 4 * H].reshape(H, 4)
        if tick:
            spool = spool + share * (command - spool)
        nominal = ahead.tendon_angle[0]
        expected = Written(ahead).optimum(
            beyond_tolerance(x, ahead), spool - nominal, command - nominal, problem.disturbance
        )
        np.testing.assert_allclose(u, expected, rtol=0, atol=1e-5)
        follow(problem)
        command = nominal + u[0]
    assert np.abs(problem.disturbance).min() > 0.0


def linear_springs(slope=10.0, stiffness=-130.0):
    """Springs that are linear: F = weight / 4 at 1.1 rad and 40 mm, contact 60 mm outward."""
    angle, height = np.linspace(-1.0, 3.2, 22), np.linspace(0.0, 0.08, 9)
    table = np.zeros((22, 9, 4))
    table[..., 0] = ROBOT.weight / 4 + slope * (angle[:, None] - 1.1) + stiffness * (height - 0.04)
    table[..., 1], table[..., 2], table[..., 3] = slope, stiffness, 0.06
    return LegSprings(LegTable(angle, height, table), 1.0)


def loaded_plant(load, ticks, **changes):
    """Yield the problem and the posture from the reference in each tick on the docstring's plant.

    Its springs are linear, and a wrench is on the torso that the MPC does not know.
    """
    quiet = {"height_tolerance": 1e-6, "tilt_tolerance": 1e-6, "dither_deg": 0.0}
    quick = {"settling": 0.4, "height_observer": 0.2, "tilt_observer": 0.2, "change": 1000.0}
    options, springs = dataclasses.replace(OPTIONS, **quiet, **quick, **changes), linear_springs()
    problem = PostureProblem(ROBOT, springs, options, H)
    base = preview(tendon_angle=np.full((H + 1, 4), 1.1), normal_force=np.full((H + 1, 4), 1.0))
    height = ROBOT.clamp_heights(0.04, 0.0, 0.0)
    force = np.tile(springs.at(np.full(4, 1.1), height).force, (H + 1, 1))
    ends, rise = ROBOT.clamps[:, :2] + 0.06 * ROBOT.outward[:, :2], np.ones((4, 3))
    rise[:, 1], rise[:, 2] = ROBOT.clamps[:, 1], -ROBOT.clamps[:, 0]
    levers = np.array([np.ones(4), ends[:, 1], -ends[:, 0]])
    q, rate, spool = np.zeros(3), np.zeros(3), np.full(4, 1.1)
    for tick in range(ticks):
        ahead = dataclasses.replace(base, normal_force=force, stamp=10**9 + round(tick * DT * 1e9))
        x = state(*(HOME + q))
        x[[11, 6, 7]] = rate
        problem.update(x, ahead, horizon_of(ahead))
        yield problem, q
        u = problem.solve().z[:4]
        follow(problem)
        for _ in range(33):
            spool = spool + 1e-3 / options.lag * (1.1 + u - spool)
            wrench = levers @ (force[0] + 10.0 * (spool - 1.1) - 130.0 * (rise @ q))
            lacking = wrench - [ROBOT.weight, 0, 0] + np.array(load)
            rate = np.linalg.solve(levers @ (130.0 * rise), lacking) / options.settling
            q = q + 1e-3 * rate


LOADS = [[-3.0, 0.0, 0.0], [-2.0, -0.1, 0.08], [0.0, 0.12, 0.0], [2.5, 0.0, -0.1]]


@pytest.mark.parametrize("load", LOADS)
def test_the_error_that_a_payload_causes_vanishes_on_a_plant_of_linear_springs(load):
    history = [(problem, q) for problem, q in loaded_plant(load, 400)]
    problem, history = history[-1][0], [q for _, q in history]
    worst = np.abs(history).max(axis=0)
    assert worst[0] > 1e-3 or worst[1:].max() > 1e-2  # without feedback it would stay there
    assert np.abs(history[-1]).max() < 2e-5  # m and rad; the tolerance is 1e-6
    assert problem.disturbance == pytest.approx(load, abs=2e-3)
    assert problem.mass == pytest.approx(ROBOT.mass - load[0] / GRAVITY, rel=1e-3)


def test_a_moving_torso_is_no_disturbance_where_it_moves_as_the_model_says():
    """With motion T_d = settling the observer sees the load alone: it follows load (1 - exp)."""
    load = np.array([-3.0, 0.05, 0.08])
    for tick, (problem, _) in enumerate(loaded_plant(load, 40, motion=0.4 / 0.2)):
        expected = load * -np.expm1(-tick * DT / 0.2)
        # the servos' model holds a command for a tick, the plant's lag is solved in steps of 1 ms
        np.testing.assert_allclose(problem.disturbance, expected, rtol=0.02, atol=2e-3)
