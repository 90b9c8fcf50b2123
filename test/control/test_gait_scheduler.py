"""Gait scheduler: rates, blends, body poses, the preview."""

import itertools

import numpy as np
import pytest
from ideal_robot import AHEAD, GAITS, NOTHING, ROBOT, SPRINGS, TICK, WALK, Ideal, stands

from slot_core.gait.route import Route
from slot_core.safety.settings import read_supervisor


# The fastest stride without a blend, at the largest velocities that it reaches one at a time.
def largest_step():
    phase = np.linspace(0, 1, 500)
    return max(
        np.abs(
            WALK.stride_table(phase + TICK * 1e-9 / WALK.period, v)[:, :4]
            - WALK.stride_table(phase, v)[:, :4]
        ).max()
        for v in (AHEAD, np.array([0.0, 0.05, 0.0]), np.array([0.0, 0.0, 0.1]))
    )


@pytest.mark.parametrize(
    ("first", "second"),
    list(itertools.permutations(["lie", "sit", "stand", "walk"], 2)),
)
def test_the_angles_are_continuous_between_any_two_gaits(first, second):
    robot = Ideal(first, AHEAD if first == "walk" else NOTHING, seconds=4.0)
    robot.scheduler.request(second, AHEAD if second == "walk" else NOTHING)
    robot.run(4.0)
    assert robot.previews[-1].gait == second
    # the whole range in a blend of a second, on top of the fastest stride
    blend = ROBOT.tendon.angle_max * TICK * 1e-9 / GAITS.transition
    assert robot.steps.max() < largest_step() + blend


def test_a_stride_stops_and_starts_again_without_a_jump():
    robot = Ideal("walk", AHEAD, seconds=4.0)
    robot.previews = robot.previews[:0]
    robot.scheduler.request("walk", NOTHING)
    stopped = robot.run(3.0)
    robot.scheduler.request("walk", AHEAD)
    robot.run(3.0)
    assert stands(stopped[-1])
    assert not stands(stopped[0])
    blend = ROBOT.tendon.angle_max * TICK * 1e-9 / GAITS.transition
    assert robot.steps.max() < largest_step() + blend


def test_a_standing_stride_stands_at_the_angles_of_its_height():
    robot = Ideal("walk", NOTHING)
    last = robot.run(4.0)[-1]
    height = ROBOT.clamp_heights(WALK.height, 0.0, 0.0)
    expected = SPRINGS.angle(np.full(4, ROBOT.weight / 4), height)
    assert last.tendon_angle == pytest.approx(np.tile(expected, (len(last.contact), 1)))
    assert stands(last)


def reached(name, share):
    """Velocity that a gait reaches when a share (3,) of its largest ones is commanded."""
    gait = GAITS.find(name)
    asked = share * np.array(gait.speeds)
    return gait.reached(asked) if name in GAITS.strides else asked


def test_no_sequence_of_commands_asks_for_more_than_the_final_check_lets_pass():
    """Random requests, velocities and poses for two minutes, at the limits of each."""
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
    assert np.isfinite(angle).all()
    assert angle.min() >= 0.0
    assert angle.max() <= ROBOT.tendon.angle_max
    assert {preview.gait for preview in robot.previews} == set(GAITS.gaits)


def test_velocity_and_yaw_rate_change_at_limited_rates():
    robot = Ideal("walk", NOTHING, seconds=3.0)
    wanted = np.array([0.05, -0.05, 0.04])
    robot.scheduler.request("walk", wanted)
    rows = np.array([p.reference[0] for p in robot.run(2.0)])
    yaw = rows[:, 2]
    torso_motion = 0.02  # m/s, of the torso over a stride
    v_x = rows[:, 9] * np.cos(yaw) + rows[:, 10] * np.sin(yaw)
    assert rows[-1, 8] == pytest.approx(0.04)
    assert (
        np.abs(np.diff(rows[:, 8])).max()
        <= GAITS.turn_acceleration * TICK * 1e-9 + 1e-12
    )
    # 0.05 m/s at 0.1 m/s^2 take 0.5 s, 15 ticks
    assert v_x[7] < 0.05 / 2 + torso_motion
    assert v_x[20:].mean() == pytest.approx(0.05, abs=torso_motion)


def test_height_and_tilt_follow_their_commands_at_limited_rates():
    robot = Ideal("stand", seconds=2.0)
    robot.scheduler.set_pose(np.array([0.055, 0.08, -0.06]))
    rows = np.array([p.reference[0, [5, 0, 1]] for p in robot.run(3.0)])
    speed = np.abs(np.diff(rows, axis=0)).max(axis=0) / (TICK * 1e-9)
    rates = np.array([GAITS.lift_speed, GAITS.tilt_speed, GAITS.tilt_speed])
    assert (speed <= rates + 1e-9).all()
    assert speed == pytest.approx(rates)
    assert rows[-1] == pytest.approx([0.055, 0.08, -0.06])


def test_the_angles_of_a_posture_balance_the_weight_at_its_heights():
    robot = Ideal("stand")
    robot.scheduler.set_pose(np.array([0.05, 0.05, 0.03]))
    last = robot.run(4.0)[-1]
    height = ROBOT.clamp_heights(0.05, 0.05, 0.03)
    force = SPRINGS.at(last.tendon_angle[0], height).force
    assert force == pytest.approx(ROBOT.weight / 4, abs=1e-9)
    assert last.normal_force[0] == pytest.approx(force)
    assert stands(last)
    assert last.contact.all()


def test_a_request_returns_the_body_pose_to_that_of_the_gait():
    robot = Ideal("stand")
    robot.scheduler.set_pose(np.array([0.055, 0.05, 0.0]))
    robot.run(3.0)
    robot.scheduler.request("sit", NOTHING)
    sit = GAITS.postures["sit"]
    row = robot.run(4.0)[-1].reference[0]
    expected = [sit.height, *np.radians([sit.roll_deg, sit.pitch_deg])]
    assert row[[5, 0, 1]] == pytest.approx(expected)


def test_lying_slackens_the_tendons_and_puts_no_leg_in_contact():
    last = Ideal("lie").run(4.0)[-1]
    assert not last.tendon_angle.any()
    assert not last.contact.any()
    assert not stands(last)


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
    ran = robot.run(GAITS.transition)
    ahead = np.array([preview.tendon_angle[1] for preview in ran[:-1]])
    came = np.array([preview.tendon_angle[0] for preview in ran[1:]])
    # the velocity changes within the stage, by a tenth of a tick's motion at most
    assert np.abs(ahead - came).max() < 0.2 * largest_step()


def test_a_stride_tilts_its_reference_as_the_body_is_commanded():
    robot = Ideal("walk", AHEAD, seconds=3.0)
    level = np.mean(
        [preview.reference[0] for preview in robot.run(WALK.period)], axis=0
    )
    robot.scheduler.set_pose(np.array([0.065, 0.08, 0.05]))
    robot.run(3.0)
    tilted = np.mean(
        [preview.reference[0] for preview in robot.run(WALK.period)], axis=0
    )
    assert tilted[[0, 1]] - level[[0, 1]] == pytest.approx([0.08, 0.05], abs=5e-3)
    assert tilted[5] - level[5] == pytest.approx(0.065 - WALK.height, abs=1e-3)


def test_a_path_asks_no_more_than_the_gait_reaches():
    """Where the path turns by 90 deg the heading along it would change at 1.6 rad/s."""
    corner = Route(np.array([[0.0, 0.0], [0.05, 0.0], [0.05, 0.5]]), "along")
    robot = Ideal("walk", AHEAD, corner, seconds=6.0)
    rates = [preview.reference[0, 8] for preview in robot.previews]
    assert max(np.abs(rates)) <= WALK.forward_steering.rate_max + 1e-9


def test_a_change_of_velocity_keeps_the_phase():
    robot = Ideal("walk", AHEAD)
    before = robot.run(3.0)[-1]
    robot.scheduler.request("walk", np.array([0.0, 0.04, 0.0]))
    after = robot.run(0.033)[0]
    assert after.phase == pytest.approx((before.phase + 0.033 / WALK.period) % 1.0)
