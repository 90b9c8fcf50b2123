"""The MPC on tendon angles as a policy: its plans, dither, bounds, fallback."""

import dataclasses
import math

import numpy as np
import pytest
from postures import CASES, ROBOT, H, known, preview, state

from slot_core import config
from slot_core.control.force_map import make_force_map, read_force_map
from slot_core.control.policy import Status
from slot_core.estimation.estimate import Estimate
from slot_core.mpc.mpc import Mpc
from slot_core.mpc.settings import read_mpc

# no time budget: the tests must not depend on the load of the machine
SETTINGS = config.replace(read_mpc(), {"acceptance.time_budget": np.inf})
OPTIONS, ANGLE_MAX = SETTINGS.posture, ROBOT.tendon.angle_max
CORRECTION = math.radians(OPTIONS.correction_max_deg)
LOST = Estimate.exact(np.full(12, math.nan))


def new_mpc(**changes):
    names = {name.replace("__", "."): value for name, value in changes.items()}
    return Mpc(ROBOT, config.replace(SETTINGS, names), lambda: 0.0)


def test_the_optimum_without_active_limits_is_found_without_iterations():
    counts = {
        name: new_mpc().step(Estimate.exact(x), ahead).report.iterations
        for name, (x, ahead) in CASES.items()
    }
    assert counts["too low"] == counts["rising"] == 1
    assert counts["at zero forces"] > 1


def test_the_commands_are_the_first_angles_of_the_plans_to_the_last_bit():
    """In some of these postures a leg is predicted to pull on the floor."""
    mpc, force_map = new_mpc(), make_force_map(ROBOT, read_force_map())
    rng, lifted = np.random.default_rng(6), 0
    for tick in range(300):
        x = state(*rng.normal([0.04, 0.0, 0.0], [0.01, 0.1, 0.1]))
        ahead = preview(tick=tick)
        plan = mpc.step(Estimate.exact(x), ahead)
        command = force_map.step(plan, ahead, x)
        np.testing.assert_array_equal(command.angle, plan.angle[0])
        assert not command.saturated.any()
        lifted += (plan.force[0, :, 2] == 0.0).any()
    assert lifted > 10


def test_the_planned_angle_is_that_of_the_problem_and_its_dither():
    mpc, rng = new_mpc(), np.random.default_rng(4)
    largest = 0.0
    for tick in range(60):
        ahead = preview([0.042, 0.02, -0.03], [0.045, 0.0, 0.0], tick)
        x = state(0.041, 0.03, -0.02) + rng.normal(0, [2e-3, 2e-3, 1, 1, 1, 5e-4, *[1] * 6], 12)
        result = mpc.step(Estimate.exact(x), ahead)
        assert result.status == Status.SOLVED
        u = mpc.problem.solve().z[:4]
        dither = result.angle[0] - ahead.tendon_angle[0] - u
        assert result.force[0, :, 2].min() > 0.0
        # what is left is one amplitude, opposite in sign on the two diagonals
        np.testing.assert_allclose(dither, dither[0] * np.array([1, -1, -1, 1]), atol=1e-9)
        assert abs(dither[0]) <= math.radians(OPTIONS.dither_deg) + 1e-9
        largest = max(largest, abs(dither[0]))
    assert largest > 0.01  # rad: there was one


def test_without_an_error_there_is_no_dither_and_the_angle_is_that_of_the_gait():
    mpc = new_mpc()
    for tick in range(20):
        ahead = preview(tick=tick)
        plan = mpc.step(known(), ahead)
        np.testing.assert_allclose(plan.angle[0], ahead.tendon_angle[0], atol=1e-6)


def test_the_dither_changes_its_sign_from_tick_to_tick_and_fades():
    mpc = new_mpc()
    amplitude = []
    for tick in range(80):
        ahead, x = preview(tick=tick), state(0.036 if tick < 5 else 0.04)
        plan = mpc.step(Estimate.exact(x), ahead)
        u = mpc.problem.solve().z[:4]
        amplitude.append(float((plan.angle[0] - ahead.tendon_angle[0] - u)[0]))
    signs = np.sign(amplitude[:30])
    assert (signs[1:] == -signs[:-1]).all()
    assert abs(amplitude[3]) == pytest.approx(math.radians(OPTIONS.dither_deg))
    # 75 ticks are 2.5 s: with a time constant of 0.4 s the dither is 0.2 % of its size
    assert abs(amplitude[-1]) < 0.01 * abs(amplitude[3])


def test_a_robot_at_its_reference_is_commanded_nothing_new():
    """However far the angles are from the gait's, where springs are no longer linear."""
    mpc = new_mpc()
    for tick in range(30):
        plan = mpc.step(known(0.037), preview(tick=tick))
    before = []
    for tick in range(30, 330):
        plan = mpc.step(known(), preview(tick=tick))
        before.append(plan.angle[0])
    assert np.abs(before[-1] - preview().tendon_angle[0]).min() > 0.05
    # the first 3 s let dither, filter and servos settle
    np.testing.assert_allclose(before[-1], before[100], rtol=0, atol=2e-3)


def absurd_states():
    rng = np.random.default_rng(8)
    yield from (scale * rng.normal(size=12) for scale in (0.1, 1.0, 10.0, 100.0) for _ in range(20))
    yield from (state(z) for z in (-1.0, 0.0, 0.2, 5.0))
    yield from (state(0.04, roll, pitch) for roll in (-3.1, 1.5) for pitch in (-1.5, 3.1))


def test_from_every_state_the_problem_is_solved_within_its_bounds():
    mpc = new_mpc()
    for tick, x in enumerate(absurd_states()):
        low = 0.03 + 0.03 * (tick % 7) / 6
        ahead = preview([low, 0.0, 0.0], tick=tick)
        result = mpc.step(Estimate.exact(x), ahead)
        assert result.status == Status.SOLVED, (tick, x, result.message)
        assert result.report.iterations <= OPTIONS.iterations
        assert result.report.violation <= SETTINGS.acceptance.violation_max
        assert np.isfinite(result.force).all()
        assert result.force[..., 2].min() >= 0.0
        assert not result.force[..., :2].any()
        u = mpc.problem.solve().z[: 4 * H].reshape(H, 4)
        assert np.abs(u).max() <= CORRECTION + 1e-6
        angle = ahead.tendon_angle[:H] + u
        assert angle.min() >= -1e-6
        assert angle.max() <= ANGLE_MAX + 1e-6
        assert result.angle.min() >= 0.0
        assert result.angle.max() <= ANGLE_MAX


def test_no_preview_within_the_limits_of_the_inputs_raises_or_asks_for_what_is_not_finite():
    """Where all legs are out of their table the stiffness is zero: the model has a least one."""
    rng, mpc = np.random.default_rng(9), new_mpc()
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
        result = mpc.step(Estimate.exact(x), preview(tick=tick, **chosen))
        assert np.isfinite(result.force).all()
        assert np.isfinite(result.angle).all()
        assert result.status != Status.REJECTED
    again = mpc.step(known(), preview(tick=151))
    assert again.status == Status.SOLVED


def test_a_stride_gets_the_forces_and_angles_of_its_gait():
    mpc = new_mpc()
    rng = np.random.default_rng(5)
    for tick in range(10):
        angle, force = rng.uniform(0.5, 1.8, (H + 1, 4)), rng.uniform(0.0, 11.0, (H + 1, 4))
        contact = force > 0.5
        ahead = preview(
            tick=tick, tendon_angle=angle, normal_force=force, contact=contact, posture=False
        )
        x = state(0.06, 0.1, -0.05)
        result = mpc.step(Estimate.exact(x), ahead)
        assert result.status == Status.SOLVED
        np.testing.assert_array_equal(result.force[0, :, 2], np.where(contact[0], force[0], 0.0))
        np.testing.assert_array_equal(result.angle, angle[:H])


def test_a_disturbance_is_forgotten_during_a_stride():
    mpc = new_mpc()
    for tick in range(10):
        mpc.step(known(0.035), preview(tick=tick))
    assert np.abs(mpc.problem.disturbance).max() > 0.1
    mpc.step(known(), preview(tick=10, posture=False))
    assert not mpc.problem.disturbance.any()


def test_the_disturbance_stays_within_its_bounds():
    mpc = new_mpc()
    for tick in range(60):
        mpc.step(known(0.0165, 0.2, -0.2), preview(tick=tick))
    moment = OPTIONS.moment_disturbance
    expected = [OPTIONS.force_disturbance, moment, moment]
    assert np.abs(mpc.problem.disturbance).tolist() == expected


@pytest.mark.parametrize("gap", [-1.0, 0.0, 0.6, 1e6])
def test_after_a_gap_the_servos_are_taken_to_be_at_the_angles_of_the_gait(gap):
    """A fresh controller gives the same forces; the disturbance is that from before the gap."""
    unobserved = {"posture__height_observer": 1e6, "posture__tilt_observer": 1e6}
    used, ahead = new_mpc(**unobserved), preview()
    for tick in range(10):
        used.step(known(0.035), preview(tick=tick))
    later = dataclasses.replace(ahead, stamp=preview(tick=9).stamp + round(gap * 1e9))
    fresh = new_mpc(**unobserved)
    for mpc in (used, fresh):
        mpc.step(known(), later)
    np.testing.assert_allclose(used.problem.solve().z, fresh.problem.solve().z, atol=1e-6)


def test_fallback_decays_to_the_angles_of_the_gait_and_then_stops():
    mpc, rule = new_mpc(), SETTINGS.fallback
    last, home = mpc.step(known(0.036), preview()), preview().tendon_angle[0]
    assert last.status == Status.SOLVED
    for n in range(1, rule.cycles + 1):
        result = mpc.step(LOST, preview(tick=n))
        assert (result.status, result.fallback_cycles) == (Status.REJECTED, n)
        expected = home + rule.decay**n * (last.angle[0] - home)
        np.testing.assert_allclose(result.angle[0], expected, atol=1e-12)
    stopped = mpc.step(LOST, preview(tick=rule.cycles + 1))
    assert stopped.status == Status.STOPPED
    assert not len(stopped.angle)
    again = mpc.step(known(), preview(tick=rule.cycles + 2))
    assert (again.status, again.fallback_cycles, again.message) == (Status.SOLVED, 0, "")


def test_too_few_iterations_are_a_fault_that_the_next_tick_does_not_inherit():
    mpc = new_mpc(posture__iterations=2)
    result = mpc.step(known(0.055, 0.2, 0.1), preview())  # forces reach zero
    assert result.status == Status.STOPPED
    assert "after 2 iterations" in result.message
    assert not result.force.any()


def test_equal_inputs_give_bit_equal_results():
    def run():
        mpc, rng = new_mpc(), np.random.default_rng(5)
        rows = [state(0.04) + 0.01 * rng.normal(size=12) for _ in range(30)]
        return [mpc.step(Estimate.exact(x), preview(tick=n)).angle for n, x in enumerate(rows)]

    np.testing.assert_array_equal(run(), run())
