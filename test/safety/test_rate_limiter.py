"""Rate limiter: vectors accepted as a whole, limited rates, torque off in limited time."""

import math

import numpy as np
import pytest

from slot_core.gait.gait import read_gaits
from slot_core.robot import read_robot
from slot_core.safety.rate_limiter import RateLimiter
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action

SETTINGS = read_supervisor().gate
LIMIT = read_robot().tendon.angle_max
TICK = 10_000_000  # ns
MIDDLE = np.full(4, 1.0)


def gate(angle=MIDDLE):
    built = RateLimiter(SETTINGS, LIMIT)
    built.engage(angle)
    return built


def run(built, action, seconds, start=0, **kwargs):
    """Steps of 10 ms; the last one's time (ns) and all results."""
    times = range(start, start + round(seconds * 1e9) + 1, TICK)
    return times[-1], [built.step(time, action, **kwargs) for time in times]


REST = [0.0] * 4
OUTSIDE = "rad is not inside [0, 2.029]"
BAD = [
    ([1.0, math.nan, 1.0, 1.0], REST, f"command FR = nan {OUTSIDE}"),
    ([1.0, 1.0, math.inf, 1.0], REST, f"command RL = inf {OUTSIDE}"),
    ([1.0, 1.0, 1.0, -1e-9], REST, f"command RR = -1e-09 {OUTSIDE}"),
    (
        [LIMIT * (1 + 1e-12), 1.0, 1.0, 1.0],
        REST,
        f"command FL = 2.029 {OUTSIDE}",
    ),
    ([1.0, 1.0, 1.0], REST, "command has the shape (3,), limit (4,)"),
    ([[1.0, 1.0, 1.0, 1.0]], REST, "command has the shape (1, 4), limit (4,)"),
    (MIDDLE, [0.0, math.nan, 0.0, 0.0], "rate FR = nan rad/s is not finite"),
    (MIDDLE, [0.0], "rate has the shape (1,), limit (4,)"),
]


@pytest.mark.parametrize(("angle", "rate", "reason"), BAD)
def test_a_vector_with_a_bad_value_is_rejected_as_a_whole_by_name(
    angle, rate, reason
):
    built = gate()
    assert built.offer(0, angle, rate) == reason
    _, results = run(built, Action.PASS, 0.5, fast=True)
    assert (np.array([goals.angle for goals in results]) == MIDDLE).all()


def test_goals_go_on_at_the_rate_of_the_command_within_the_range_until_it_is_held():
    built = gate()
    time, _ = run(built, Action.PASS, 1.0, fast=True)
    rate = np.array([1.0, -2.0, 0.0, 12.0])
    assert built.offer(time, MIDDLE, rate) == ""
    _, results = run(built, Action.PASS, 0.1, time, fast=True)
    assert results[2].angle == pytest.approx(MIDDLE + 0.02 * rate)
    assert results[10].angle == pytest.approx([1.1, 0.8, 1.0, LIMIT])
    # no command comes
    _, later = run(built, Action.PASS, 0.5, time + 11 * TICK, fast=True)
    assert later[-1].angle == pytest.approx(results[10].angle)
    built.offer(time + 70 * TICK, MIDDLE, rate)
    _, held = run(built, Action.HOLD, 0.1, time + 70 * TICK)
    assert (held[-1].angle == later[-1].angle).all()


def test_a_step_larger_than_the_rate_limit_is_slewed_and_reported():
    built = gate(np.zeros(4))
    # the rate has grown to its largest
    time, _ = run(built, Action.PASS, 1.0, fast=True)
    assert built.offer(time, [LIMIT, 0.5, 0.0, 0.0]) == ""
    first = built.step(time + TICK, Action.PASS, fast=True)
    assert first.slewed.tolist() == [True, False, False, False]
    assert first.angle == pytest.approx(
        [SETTINGS.rate_max * SETTINGS.burst, 0.5, 0.0, 0.0]
    )
    _, results = run(built, Action.PASS, 0.1, time + 2 * TICK, fast=True)
    assert results[-1].angle[0] == LIMIT
    assert not results[-1].slewed.any()


def test_every_step_of_every_gait_passes_unchanged():
    """At each largest velocity, sampled at the odometry's 33 ms, from every phase."""
    period = 0.033
    strides = read_gaits().strides.values()
    for gait, velocity in ((g, v) for g in strides for v in np.diag(g.speeds)):
        built = gate()
        phase = np.arange(0.0, 20.0, period) / gait.period % 1.0
        angle = gait.stride_table(phase, velocity)[:, :4]
        time, _ = run(built, Action.PASS, 1.0, fast=True)
        built.offer(time, angle[0])
        time, _ = run(built, Action.PASS, 1.0, time, fast=True)
        for k, row in enumerate(angle[1:], 1):
            now = time + round(k * period * 1e9)
            built.offer(now, row)
            goals = built.step(now, Action.PASS, fast=True)
            assert (goals.angle == row).all()
            assert not goals.slewed.any()


@pytest.mark.parametrize("angle", [0.0, LIMIT])
def test_relax_ends_slack_and_without_torque_within_relax_time(angle):
    built = gate(np.full(4, angle))
    time, results = run(built, Action.RELAX, SETTINGS.relax_time)
    assert not results[-1].torque
    _, later = run(built, Action.RELAX, 3.0, time)
    assert not any(goals.torque for goals in later)
    assert (results[-1].angle == 0.0).all()
    falling = np.diff([goals.angle[0] for goals in results])
    assert falling.max(initial=0.0) <= 0.0
    # a ramp: only the first step may use the rest of its budget at once
    assert (
        falling.min(initial=0.0)
        >= -SETTINGS.relax_rate * SETTINGS.burst - 1e-12
    )
    rare = gate(np.full(4, angle))  # steps
    rare.step(0, Action.RELAX)
    assert not rare.step(time, Action.RELAX).torque


def test_no_sequence_of_commands_and_actions_exceeds_range_or_rate():
    rng = np.random.default_rng(3)
    built = gate()
    time, times, angles = 0, [], []
    for _ in range(20_000):
        time += int(
            rng.choice([0, 1, 1_000_000, 10_000_000, 33_000_000, 400_000_000])
        )
        kind = rng.integers(4)
        if kind == 0:
            built.offer(
                time,
                rng.uniform(0, LIMIT, 4),
                rng.normal(0, 10, 4) * rng.integers(2),
            )
        elif kind == 1:
            spoilt = rng.normal(0, 1e6, 4) * rng.choice(
                [1.0, math.nan, math.inf]
            )
            built.offer(
                time, *((spoilt,) if rng.integers(2) else (MIDDLE, spoilt))
            )
        goals = built.step(
            time,
            rng.choice(list(Action)),
            fast=bool(rng.integers(2)),
            ease=rng.choice([None, 0.0, LIMIT]),
        )
        times.append(time * 1e-9)
        angles.append(goals.angle)
    angle = np.array(angles)
    assert ((angle >= 0.0) & (angle <= LIMIT)).all()
    for lag in (1, 3, 10):
        moved = np.abs(angle[lag:] - angle[:-lag]).max(axis=1)
        span = np.array(times[lag:]) - np.array(times[:-lag])
        # 1e-9: rounding of sums of some twenty steps
        assert (
            moved <= SETTINGS.rate_max * (span + SETTINGS.burst) + 1e-9
        ).all()
    assert np.ptp(angle[:, 0]) > 1.0  # the goals did move
