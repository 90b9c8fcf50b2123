"""Gait scheduler: rates, blends, body poses, the preview."""

import itertools

import numpy as np
import pytest
from ideal_robot import AHEAD, GAITS, NOTHING, ROBOT, SPRINGS, TICK, WALK, Ideal, stands

from slot_core.clock import SECOND
from slot_core.safety.settings import read_supervisor


# The fastest stride without a blend, at the largest velocities that it reaches one at a time.
def largest_step():
    phase, ahead = np.linspace(0, 1, 500), TICK * 1e-9 / WALK.period
    return max(
        np.ptp(
            [WALK.stride_table(p, v)[:, :4] for p in (phase, phase + ahead)], axis=0
        ).max()
        for v in np.diag([AHEAD[0], 0.05, 0.1])
    )


GAIT_PAIRS = [
    *itertools.permutations(["lie", "sit", "stand", "walk"], 2),
    ("walk", "walk without velocity"),
    ("walk without velocity", "walk"),
]


@pytest.mark.parametrize(("first", "second"), GAIT_PAIRS)
def test_the_angles_are_continuous_between_any_two_gaits(first, second):
    robot = Ideal(first.split()[0], AHEAD if first == "walk" else NOTHING, seconds=4.0)
    robot.scheduler.request(second.split()[0], AHEAD if second == "walk" else NOTHING)
    robot.run(4.0)
    assert robot.previews[-1].gait == second.split()[0]
    # the whole range in a blend of a second, on top of the fastest stride
    blend = ROBOT.tendon.angle_max * TICK * 1e-9 / GAITS.transition
    assert robot.steps.max() < largest_step() + blend


@pytest.mark.parametrize("gait", ["stand", "walk"])
@pytest.mark.parametrize("pose", [None, [0.055, 0.05, 0.03]])
def test_a_robot_at_rest_balances_its_weight_at_its_heights(gait, pose):
    robot, home = Ideal(gait), [GAITS.find(gait).height, 0.0, 0.0]
    if pose is not None:
        robot.scheduler.set_pose(pose)
    last = robot.run(4.0)[-1]
    force = SPRINGS.at(last.tendon_angle[0], ROBOT.clamp_heights(*(pose or home))).force
    assert force == pytest.approx(ROBOT.weight / 4, abs=1e-9)
    assert last.normal_force[0] == pytest.approx(force)
    assert stands(last)
    assert last.contact.all()


def reached(name, share):
    """Velocity that a gait reaches when a share (3,) of its largest ones is commanded."""
    gait = GAITS.find(name)
    asked = share * np.array(gait.speeds)
    return gait.reached(asked) if name in GAITS.strides else asked


def test_no_sequence_of_commands_asks_for_more_than_the_final_check_lets_pass():
    """Random requests, velocities and poses for two minutes, at the limits of each.

    Everything commanded can be set again from the recorded previews.
    """
    rng, robot = np.random.default_rng(6), Ideal()
    for _ in range(60):
        kind, gait = rng.integers(3), str(rng.choice(sorted(GAITS.gaits)))
        present = robot.scheduler._requested
        if kind == 0:
            robot.scheduler.request(gait, reached(gait, rng.uniform(-1.0, 1.0, 3)))
        elif kind == 1:
            fastest = reached(present, rng.choice([-1.0, 0.0, 1.0], 3))
            robot.scheduler.set_velocity(robot.now, fastest)
        elif present != "lie":
            low, high = GAITS.find(present).height_range
            tilt = GAITS.tilt_max * rng.choice([-1.0, 1.0], 2)
            robot.scheduler.set_pose(np.array([rng.choice([low, high]), *tilt]))
        robot.run(rng.uniform(0.1, 4.0))
    for gait in sorted(GAITS.gaits):  # whichever of them were not drawn
        robot.scheduler.request(gait, reached(gait, rng.uniform(-1.0, 1.0, 3)))
        robot.run(1.2 * GAITS.transition)
    gate = read_supervisor().gate
    # A blend of two strides that reach from end to end of the range: 1.66 rad once, of 2.02.
    assert robot.steps.max() < 1.05 * gate.rate_max * gate.burst
    angle = np.array([preview.tendon_angle for preview in robot.previews])
    assert 0.0 <= angle.min() <= angle.max() <= ROBOT.tendon.angle_max  # NaN is not
    assert {preview.gait for preview in robot.previews} == set(GAITS.gaits)
    replayed = Ideal()
    for preview in robot.previews:
        replayed.scheduler.set_command(preview.command)
        (again,) = replayed.run(TICK / SECOND)
        assert (again.tendon_angle == preview.tendon_angle).all()
        assert (again.reference == preview.reference).all()


def test_velocity_and_yaw_rate_change_at_limited_rates_and_keep_the_phase():
    robot = Ideal("walk", AHEAD, seconds=3.0)
    before = robot.previews[-1]
    robot.scheduler.request("walk", np.array([0.05, -0.05, 0.04]))
    after = robot.run(2.0)
    assert after[0].phase == pytest.approx((before.phase + 0.033 / WALK.period) % 1.0)
    rows = np.array([preview.reference[0] for preview in after])
    turning = np.abs(np.diff(rows[:, 8])).max() / (TICK * 1e-9)
    assert turning <= GAITS.turn_acceleration + 1e-9
    assert rows[-1, 8] == pytest.approx(0.04)
    v_y = rows[:, 10] * np.cos(rows[:, 2]) - rows[:, 9] * np.sin(rows[:, 2])
    # 0.05 m/s at 0.1 m/s^2 take 0.5 s, 15 ticks; 0.02 m/s: of the torso over a stride
    assert v_y[7] > -0.05 / 2 - 0.02
    assert v_y[20:].mean() == pytest.approx(-0.05, abs=0.02)


def test_height_and_tilt_follow_their_commands_at_limited_rates_until_a_request():
    robot = Ideal("stand", seconds=2.0)
    robot.scheduler.set_pose(np.array([0.055, 0.08, -0.06]))
    rows = np.array([p.reference[0, [5, 0, 1]] for p in robot.run(3.0)])
    speed = np.abs(np.diff(rows, axis=0)).max(axis=0) / (TICK * 1e-9)
    rates = np.array([GAITS.lift_speed, GAITS.tilt_speed, GAITS.tilt_speed])
    assert (speed <= rates + 1e-9).all()
    assert speed == pytest.approx(rates)
    assert rows[-1] == pytest.approx([0.055, 0.08, -0.06])
    robot.scheduler.request("sit", NOTHING)
    sit, row = GAITS.postures["sit"], robot.run(4.0)[-1].reference[0]
    home = [sit.height, *np.radians([sit.roll_deg, sit.pitch_deg])]
    assert row[[5, 0, 1]] == pytest.approx(home)


def test_stage_k_of_the_preview_is_stage_0_of_the_tick_k_later():
    robot = Ideal("walk", AHEAD, seconds=4.0)
    early, later = robot.run(3 * 0.033), robot.run(0.033)[0]
    assert early[0].tendon_angle[3:] == pytest.approx(later.tendon_angle[:-3], abs=1e-9)
    assert early[0].reference[3:, :2] == pytest.approx(
        later.reference[:-3, :2], abs=1e-9
    )
    assert (early[0].contact[3:] == later.contact[:-3]).all()


@pytest.mark.parametrize(
    ("first", "second"), [("walk", "stand"), ("walk", "fast_walk"), ("stand", "walk")]
)
def test_the_preview_of_a_blend_is_that_of_the_next_ticks(first, second):
    robot = Ideal(first, AHEAD if first != "stand" else NOTHING, seconds=4.0)
    robot.scheduler.request(second, AHEAD if second != "stand" else NOTHING)
    angle = np.array([preview.tendon_angle for preview in robot.run(GAITS.transition)])
    # the velocity changes within the stage, by a tenth of a tick's motion at most
    assert np.abs(angle[:-1, 1] - angle[1:, 0]).max() < 0.2 * largest_step()


def test_a_stride_tilts_its_reference_as_the_body_is_commanded():
    def mean():
        return np.mean([p.reference[0] for p in robot.run(WALK.period)], axis=0)

    robot = Ideal("walk", AHEAD, seconds=3.0)
    level = mean()
    robot.scheduler.set_pose(np.array([0.065, 0.08, 0.05]))
    robot.run(3.0)
    tilt_x, tilt_y, *_, lift = (mean() - level)[:6]
    assert [tilt_x, tilt_y] == pytest.approx([0.08, 0.05], abs=5e-3)
    assert lift == pytest.approx(0.065 - WALK.height, abs=1e-3)
