"""MPC on tendon angles against CVXPY with Clarabel, written from the equations of its docstring."""

import dataclasses
import math

import cvxpy
import numpy as np
import pytest

from slot_core import config
from slot_core.control.force_map import make_force_map, read_force_map, read_springs
from slot_core.control.policy import Status
from slot_core.gait.gait import GaitCommand, GaitPreview
from slot_core.legs.leg_springs import LegSprings
from slot_core.legs.leg_table import LegTable
from slot_core.mpc.model import Horizon
from slot_core.mpc.mpc import Mpc
from slot_core.mpc.posture_problem import PostureProblem
from slot_core.mpc.settings import read_mpc
from slot_core.robot import GRAVITY, read_robot

ROBOT = read_robot()
# no time budget: the tests must not depend on the load of the machine
SETTINGS = config.replace(read_mpc(), {"acceptance.time_budget": np.inf})
OPTIONS, H, DT = SETTINGS.posture, SETTINGS.horizon, 0.033
SPRINGS = read_springs()
CORRECTION = math.radians(OPTIONS.correction_max_deg)
ANGLE_MAX = ROBOT.tendon.angle_max
HOME = np.array([0.04, 0.0, 0.0])  # z, roll, pitch


def state(z=0.04, roll=0.0, pitch=0.0):
    x = np.zeros(12)
    x[[5, 0, 1]] = z, roll, pitch
    return x


def preview(start=HOME, end=None, tick=0, **changes):
    """A posture that moves from `start` to `end` (3,) over the horizon, at its tendon angles."""
    rows = np.linspace(start, start if end is None else end, H + 1)
    reference = np.zeros((H + 1, 12))
    reference[:, [5, 0, 1]] = rows
    height = ROBOT.clamp_heights(*np.transpose(rows))
    share = np.full(4, ROBOT.weight / 4)
    angle = np.array([SPRINGS.angle(share, row) for row in height])
    values = {
        "contact": np.ones((H + 1, 4), dtype=bool),
        "friction": np.full((H + 1, 4), 0.4),
        "normal_force": SPRINGS.at(angle, height).force,
        "tendon_angle": angle,
        "reference": reference,
        "posture": True,
    } | changes
    command = GaitCommand("stand", np.zeros(3), np.asarray(start))
    return GaitPreview(
        stamp=10**9 + round(tick * DT * 1e9), gait="stand", phase=0.0, period=1.0, dt=DT,
        command=command, **values,
    )  # fmt: skip


def new_mpc(**changes):
    names = {name.replace("__", "."): value for name, value in changes.items()}
    return Mpc(ROBOT, config.replace(SETTINGS, names), lambda: 0.0)


def angles_of(force_map, mpc, x, ahead):
    """The result of a tick, and the tendon angles (4,) that the force map makes of it."""
    result = mpc.step(x, ahead)
    return result, force_map.step(result.force, force_map.nominal(ahead, x))


def springs_map():
    return make_force_map(ROBOT, read_force_map(), "springs")


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


CASES = {
    "at the reference": (state(), preview()),
    "too low": (state(0.034), preview()),
    "too high": (state(0.047, 0.01), preview()),
    "tilted": (state(0.041, 0.08, -0.06), preview()),
    "at zero forces": (state(0.055, 0.2, 0.1), preview()),
    "rising": (state(0.032), preview([0.032, 0, 0], [0.045, 0, 0])),
    "rolling": (state(0.05), preview([0.05, 0, 0], [0.05, 0.05, -0.03])),
    "near the fold": (state(0.055), preview([0.06, 0, 0])),
    "on the belly": (state(0.0165), preview([0.03, 0, 0])),
    "upside down": (state(0.04, 3.0), preview()),
    "lifted": (state(0.12), preview()),
}


@pytest.mark.parametrize("case", CASES)
def test_the_first_angles_are_the_optimum_of_the_documented_problem(case):
    x, ahead = CASES[case]
    problem = PostureProblem(ROBOT, SPRINGS, OPTIONS, H)
    problem.update(x, ahead, horizon_of(ahead))
    found = problem.solve()
    assert found.fault == ""
    u = Written(ahead).optimum(beyond_tolerance(x, ahead), np.zeros(4), np.zeros(4), np.zeros(3))
    np.testing.assert_allclose(found.z[: 4 * H].reshape(H, 4), u, rtol=0, atol=1e-5)


def test_the_optimum_without_active_limits_is_found_without_iterations():
    counts = {name: new_mpc().step(*case).iterations for name, case in CASES.items()}
    assert counts["too low"] == counts["rising"] == 1
    assert counts["at zero forces"] > 1


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
        problem.follow(problem.forces(problem.solve().z)[0])
        command = nominal + u[0]
    assert np.abs(problem.disturbance).min() > 0.0


def test_the_angle_of_the_force_map_is_that_of_the_mpc_and_its_dither():
    mpc, force_map, rng = new_mpc(), springs_map(), np.random.default_rng(4)
    largest = 0.0
    for tick in range(60):
        ahead = preview([0.042, 0.02, -0.03], [0.045, 0.0, 0.0], tick)
        x = state(0.041, 0.03, -0.02) + rng.normal(0, [2e-3, 2e-3, 1, 1, 1, 5e-4, *[1] * 6], 12)
        result, command = angles_of(force_map, mpc, x, ahead)
        assert result.status == Status.SOLVED
        u = mpc.problem.solve().z[:4]
        dither = command.angle_unclamped - ahead.tendon_angle[0] - u
        assert result.force[:, 2].min() > 0.0
        # what is left is one amplitude, opposite in sign on the two diagonals
        np.testing.assert_allclose(dither, dither[0] * np.array([1, -1, -1, 1]), atol=1e-9)
        assert abs(dither[0]) <= math.radians(OPTIONS.dither_deg) + 1e-9
        largest = max(largest, abs(dither[0]))
    assert largest > 0.01  # rad: there was one


def test_without_an_error_there_is_no_dither_and_the_angle_is_that_of_the_gait():
    mpc, force_map = new_mpc(), springs_map()
    for tick in range(20):
        ahead = preview(tick=tick)
        _, command = angles_of(force_map, mpc, state(), ahead)
        np.testing.assert_allclose(command.angle, ahead.tendon_angle[0], atol=1e-6)


def test_the_dither_changes_its_sign_from_tick_to_tick_and_fades():
    mpc, force_map = new_mpc(), springs_map()
    amplitude = []
    for tick in range(80):
        ahead, x = preview(tick=tick), state(0.036 if tick < 5 else 0.04)
        _, command = angles_of(force_map, mpc, x, ahead)
        u = mpc.problem.solve().z[:4]
        amplitude.append(float((command.angle - ahead.tendon_angle[0] - u)[0]))
    signs = np.sign(amplitude[:30])
    assert (signs[1:] == -signs[:-1]).all()
    assert abs(amplitude[3]) == pytest.approx(math.radians(OPTIONS.dither_deg))
    # 75 ticks are 2.5 s: with a time constant of 0.4 s the dither is 0.2 % of its size
    assert abs(amplitude[-1]) < 0.01 * abs(amplitude[3])


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
        problem.follow(problem.forces(problem.solve().z)[0])
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


def test_a_robot_at_its_reference_is_commanded_nothing_new():
    """However far the angles are from the gait's, where springs are no longer linear."""
    mpc, force_map = new_mpc(), springs_map()
    for tick in range(30):
        _, command = angles_of(force_map, mpc, state(0.037), preview(tick=tick))
    before = []
    for tick in range(30, 330):
        _, command = angles_of(force_map, mpc, state(), preview(tick=tick))
        before.append(command.angle)
    assert np.abs(before[-1] - preview().tendon_angle[0]).min() > 0.05
    # the first 3 s let dither, filter and servos settle
    np.testing.assert_allclose(before[-1], before[100], rtol=0, atol=2e-3)


def absurd_states():
    rng = np.random.default_rng(8)
    yield from (scale * rng.normal(size=12) for scale in (0.1, 1.0, 10.0, 100.0) for _ in range(20))
    yield from (state(z) for z in (-1.0, 0.0, 0.2, 5.0))
    yield from (state(0.04, roll, pitch) for roll in (-3.1, 1.5) for pitch in (-1.5, 3.1))


def test_from_every_state_the_problem_is_solved_within_its_bounds():
    mpc, force_map = new_mpc(), springs_map()
    for tick, x in enumerate(absurd_states()):
        low = 0.03 + 0.03 * (tick % 7) / 6
        ahead = preview([low, 0.0, 0.0], tick=tick)
        result, command = angles_of(force_map, mpc, x, ahead)
        assert result.status == Status.SOLVED, (tick, x, result.message)
        assert result.iterations <= OPTIONS.iterations
        assert result.violation <= SETTINGS.acceptance.violation_max
        assert np.isfinite(result.force).all()
        assert result.force[:, 2].min() >= 0.0
        assert not result.force[:, :2].any()
        u = mpc.problem.solve().z[: 4 * H].reshape(H, 4)
        assert np.abs(u).max() <= CORRECTION + 1e-6
        angle = ahead.tendon_angle[:H] + u
        assert angle.min() >= -1e-6
        assert angle.max() <= ANGLE_MAX + 1e-6
        assert command.angle.min() >= 0.0
        assert command.angle.max() <= ANGLE_MAX


def test_no_preview_within_the_limits_of_the_inputs_raises_or_asks_for_what_is_not_finite():
    """Where all legs are out of their table the stiffness is zero: the model has a least one."""
    rng, mpc, force_map = np.random.default_rng(9), new_mpc(), springs_map()
    most = SETTINGS.acceptance.input_max
    for tick in range(150):
        size = most ** rng.uniform(-1, 1, 3)
        changes = {
            "reference": np.clip(size[0] * rng.normal(size=(H + 1, 12)), -most, most),
            "tendon_angle": np.clip(size[1] * rng.normal(size=(H + 1, 4)), -most, most),
            "normal_force": np.clip(size[2] * rng.normal(size=(H + 1, 4)), -most, most),
        }
        chosen = {name: value for name, value in changes.items() if rng.random() < 0.5}
        x = state(*rng.normal([0.04, 0, 0], [0.01, 0.1, 0.1]))
        result, command = angles_of(force_map, mpc, x, preview(tick=tick, **chosen))
        assert np.isfinite(result.force).all()
        assert np.isfinite(command.angle).all()
        assert result.status != Status.REJECTED
    again = mpc.step(state(), preview(tick=151))
    assert again.status == Status.SOLVED


def test_a_stride_gets_the_forces_of_its_gait_and_its_own_angles():
    mpc, force_map = new_mpc(), springs_map()
    rng = np.random.default_rng(5)
    for tick in range(10):
        angle, force = rng.uniform(0.5, 1.8, (H + 1, 4)), rng.uniform(0.0, 11.0, (H + 1, 4))
        contact = force > 0.5
        ahead = preview(
            tick=tick, tendon_angle=angle, normal_force=force, contact=contact, posture=False
        )
        x = state(0.06, 0.1, -0.05)
        result, command = angles_of(force_map, mpc, x, ahead)
        assert result.status == Status.SOLVED
        np.testing.assert_array_equal(result.force[:, 2], np.where(contact[0], force[0], 0.0))
        np.testing.assert_allclose(command.angle, angle[0], rtol=0, atol=1e-12)


def test_a_disturbance_is_forgotten_during_a_stride():
    mpc = new_mpc()
    for tick in range(10):
        mpc.step(state(0.035), preview(tick=tick))
    assert np.abs(mpc.problem.disturbance).max() > 0.1
    mpc.step(state(), preview(tick=10, posture=False))
    assert not mpc.problem.disturbance.any()


def test_the_disturbance_stays_within_its_bounds():
    mpc = new_mpc()
    for tick in range(60):
        mpc.step(state(0.0165, 0.2, -0.2), preview(tick=tick))
    moment = OPTIONS.moment_disturbance
    expected = [OPTIONS.force_disturbance, moment, moment]
    assert np.abs(mpc.problem.disturbance).tolist() == expected


@pytest.mark.parametrize("gap", [-1.0, 0.0, 0.6, 1e6])
def test_after_a_gap_the_servos_are_taken_to_be_at_the_angles_of_the_gait(gap):
    """A fresh controller gives the same forces; the disturbance is that from before the gap."""
    unobserved = {"posture__height_observer": 1e6, "posture__tilt_observer": 1e6}
    used, ahead = new_mpc(**unobserved), preview()
    for tick in range(10):
        used.step(state(0.035), preview(tick=tick))
    later = dataclasses.replace(ahead, stamp=preview(tick=9).stamp + round(gap * 1e9))
    fresh = new_mpc(**unobserved)
    for mpc in (used, fresh):
        mpc.step(state(), later)
    np.testing.assert_allclose(used.problem.solve().z, fresh.problem.solve().z, atol=1e-6)


BAD = {
    "state[5] = nan": (state(math.nan), preview()),
    "state[0] = inf": (state(0.04, math.inf), preview()),
    "preview.tendon_angle[0, 0] = nan": (
        state(), preview(tendon_angle=np.full((H + 1, 4), math.nan)),
    ),
    "preview.normal_force[0, 0] = inf": (
        state(), preview(normal_force=np.full((H + 1, 4), math.inf)),
    ),
    "preview.reference[0, 0] = nan": (
        state(), preview(reference=np.full((H + 1, 12), math.nan)),
    ),
    "preview.tendon_angle: shape (64,)": (state(), preview(tendon_angle=np.ones(64))),
}  # fmt: skip


@pytest.mark.parametrize("fault", BAD)
def test_bad_input_is_rejected_and_has_no_later_effect(fault):
    mpc, other = new_mpc(), new_mpc()
    for tick in range(3):
        good = mpc.step(state(0.037), preview(tick=tick))
        other.step(state(0.037), preview(tick=tick))
    x, ahead = BAD[fault]
    result = mpc.step(x, dataclasses.replace(ahead, stamp=preview(tick=3).stamp))
    assert result.status == Status.REJECTED
    assert fault in result.message
    assert "\n" not in result.message
    assert np.isfinite(result.force).all()
    if "normal_force" not in fault and "shape" not in fault:
        hover = preview().normal_force[0]
        expected = hover + SETTINGS.fallback.decay * (good.force[:, 2] - hover)
        np.testing.assert_allclose(result.force[:, 2], expected, atol=1e-9)
    again = mpc.step(state(0.037), preview(tick=4))
    assert again.status == Status.SOLVED
    assert np.isfinite(mpc.problem.disturbance).all()


def test_fallback_decays_to_the_normal_forces_of_the_gait_and_then_stops():
    mpc, rule = new_mpc(), SETTINGS.fallback
    last, hover = mpc.step(state(0.036), preview()), preview().normal_force[0]
    assert last.status == Status.SOLVED
    for n in range(1, rule.cycles + 1):
        result = mpc.step(np.full(12, np.nan), preview(tick=n))
        assert (result.status, result.fallback_cycles) == (Status.REJECTED, n)
        expected = hover + rule.decay**n * (last.force[:, 2] - hover)
        np.testing.assert_allclose(result.force[:, 2], expected, atol=1e-12)
    stopped = mpc.step(np.full(12, np.nan), preview(tick=rule.cycles + 1))
    assert stopped.status == Status.STOPPED
    assert not stopped.force.any()
    again = mpc.step(state(), preview(tick=rule.cycles + 2))
    assert (again.status, again.fallback_cycles, again.message) == (Status.SOLVED, 0, "")


def test_too_few_iterations_are_a_fault_that_the_next_tick_does_not_inherit():
    mpc = new_mpc(posture__iterations=2)
    result = mpc.step(state(0.055, 0.2, 0.1), preview())  # forces reach zero
    assert result.status == Status.STOPPED
    assert "after 2 iterations" in result.message
    assert not result.force.any()


def test_equal_inputs_give_bit_equal_results():
    def run():
        mpc, rng = new_mpc(), np.random.default_rng(5)
        rows = [state(0.04) + 0.01 * rng.normal(size=12) for _ in range(30)]
        return [dataclasses.astuple(mpc.step(x, preview(tick=n))) for n, x in enumerate(rows)]

    for one, other in zip(run(), run()):
        for a, b in zip(one, other):
            np.testing.assert_array_equal(a, b)
