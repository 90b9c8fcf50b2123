"""Gait scheduler: rates, blends, expiry of commands, refused requests, the preview."""

import itertools
import math

import numpy as np
import pytest

from slot_core.clock import SECOND
from slot_core.config import ConfigError
from slot_core.control.force_map import read_springs
from slot_core.gait.gait import GaitCommand, read_gaits
from slot_core.gait.gait_scheduler import SETTLING, GaitScheduler
from slot_core.gait.route import ARRIVED, LEAD, Route
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor

ROBOT, GAITS = read_robot(), read_gaits()
SPRINGS = read_springs()
WALK = GAITS.strides["walk"]
TICK = 33_000_000  # ns
NOTHING = np.zeros(3)
AHEAD = np.array([0.05, 0.0, 0.0])


def state(x=0.0, y=0.0, yaw=0.0, z=0.06):
    row = np.zeros(12)
    row[[3, 4, 2, 5]] = x, y, yaw, z
    return row


class Ideal:
    """A robot that moves exactly as its reference says, driven by the scheduler's own ticks."""

    def __init__(self, gait="stand", velocity=NOTHING, path=None):
        self.scheduler = GaitScheduler(GAITS, ROBOT, SPRINGS, gait, velocity, path)
        self.now, self.state, self.previews = SECOND, state(), []

    def run(self, seconds):
        """Previews of the ticks of that time."""
        ran = []
        for _ in range(round(seconds * SECOND / TICK)):
            ran.append(self.scheduler.step(self.now, self.state))
            reference = ran[-1].reference[0]
            v = reference[[9, 10, 8]] if ran[-1].gait in GAITS.strides else np.zeros(3)
            self.state[[3, 4, 2]] += v * TICK * 1e-9
            self.state[[5, 0, 1]] = reference[[5, 0, 1]]
            self.now += TICK
        self.previews += ran
        return ran

    @property
    def steps(self):
        """Largest change (n,) of an angle from tick to tick, rad."""
        angle = np.array([preview.tendon_angle[0] for preview in self.previews])
        return np.abs(np.diff(angle, axis=0)).max(axis=1)


# The fastest stride without a blend, at the largest velocities that it reaches one at a time.
def largest_step():
    phase = np.linspace(0, 1, 500)
    return max(
        np.abs(
            WALK.stride_table(phase + TICK * 1e-9 / WALK.period, v, WALK.walking(v), np.zeros(4))[
                :, :4
            ]
            - WALK.stride_table(phase, v, WALK.walking(v), np.zeros(4))[:, :4]
        ).max()
        for v in (AHEAD, np.array([0.0, 0.05, 0.0]), np.array([0.0, 0.0, 0.1]))
    )


@pytest.mark.parametrize(
    ("first", "second"), list(itertools.permutations(["lie", "sit", "stand", "walk"], 2))
)
def test_the_angles_are_continuous_between_any_two_gaits(first, second):
    robot = Ideal(first, AHEAD if first == "walk" else NOTHING)
    robot.run(4.0)
    robot.scheduler.request(second, AHEAD if second == "walk" else NOTHING)
    robot.run(4.0)
    assert robot.previews[-1].gait == second
    # the whole range in a blend of a second, on top of the fastest stride
    blend = ROBOT.tendon.angle_max * TICK * 1e-9 / GAITS.transition
    assert robot.steps.max() < largest_step() + blend


def test_a_stride_stops_and_starts_again_without_a_jump():
    robot = Ideal("walk", AHEAD)
    robot.run(4.0)
    feedback = robot.scheduler._current.feedback
    feedback.corrections[:] = [0.03, -0.02, 0.05, 0.2, -0.1, 0.1]  # as found against a disturbance
    robot.previews = robot.previews[:0]
    robot.scheduler.request("walk", NOTHING)
    stopped = robot.run(3.0)
    robot.scheduler.request("walk", AHEAD)
    robot.run(3.0)
    assert stopped[-1].posture
    assert not stopped[0].posture
    blend = ROBOT.tendon.angle_max * TICK * 1e-9 / GAITS.transition
    # amplitudes to 1.3 by the changes of the velocity
    assert robot.steps.max() < 1.5 * largest_step() + blend


def test_a_standing_stride_stands_at_the_angles_of_its_height():
    robot = Ideal("walk", NOTHING)
    last = robot.run(4.0)[-1]
    height = ROBOT.clamp_heights(WALK.height, 0.0, 0.0)
    expected = SPRINGS.angle(np.full(4, ROBOT.weight / 4), height)
    assert last.tendon_angle == pytest.approx(np.tile(expected, (len(last.contact), 1)))
    assert last.posture


def reached(name, share):
    """What a gait reaches of a share (3,) of its largest velocities."""
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
    gate = read_supervisor().gate
    # A blend of two strides that reach from end to end of the range: 1.66 rad once, of 2.02.
    assert robot.steps.max() < 1.05 * gate.rate_max * gate.burst
    angle = np.array([preview.tendon_angle for preview in robot.previews])
    assert np.isfinite(angle).all()
    assert angle.min() >= 0.0
    assert angle.max() <= ROBOT.tendon.angle_max
    assert {preview.gait for preview in robot.previews} == set(GAITS.gaits)


def test_velocity_and_yaw_rate_change_at_limited_rates():
    robot = Ideal("walk", NOTHING)
    robot.run(3.0)
    wanted = np.array([0.05, -0.05, 0.04])
    robot.scheduler.request("walk", wanted)
    rows = np.array([p.reference[0] for p in robot.run(2.0)])
    yaw = rows[:, 2]
    torso_motion = 0.02  # m/s, of the torso over a stride
    v_x = rows[:, 9] * np.cos(yaw) + rows[:, 10] * np.sin(yaw)
    assert rows[-1, 8] == pytest.approx(0.04)
    assert np.abs(np.diff(rows[:, 8])).max() <= GAITS.turn_acceleration * TICK * 1e-9 + 1e-12
    # 0.05 m/s at 0.1 m/s^2 take 0.5 s, 15 ticks
    assert v_x[7] < 0.05 / 2 + torso_motion
    assert v_x[20:].mean() == pytest.approx(0.05, abs=torso_motion)


def test_height_and_tilt_follow_their_commands_at_limited_rates():
    robot = Ideal("stand")
    robot.run(2.0)
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
    assert last.posture
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
    assert not last.posture


def test_stage_k_of_the_preview_is_stage_0_of_the_tick_k_later():
    robot = Ideal("walk", AHEAD)
    robot.run(4.0)
    early, later = robot.run(3 * 0.033), robot.run(0.033)[0]
    assert early[0].tendon_angle[3:] == pytest.approx(later.tendon_angle[:-3], abs=1e-9)
    assert early[0].reference[3:, :2] == pytest.approx(later.reference[:-3, :2], abs=1e-9)
    assert (early[0].contact[3:] == later.contact[:-3]).all()


@pytest.mark.parametrize(
    ("first", "second"), [("walk", "stand"), ("walk", "fast_walk"), ("stand", "walk")]
)
def test_the_preview_of_a_blend_is_that_of_the_next_ticks(first, second):
    robot = Ideal(first, AHEAD if first != "stand" else NOTHING)
    robot.run(4.0)
    robot.scheduler.request(second, AHEAD if second != "stand" else NOTHING)
    ran = robot.run(GAITS.transition)
    ahead = np.array([preview.tendon_angle[1] for preview in ran[:-1]])
    came = np.array([preview.tendon_angle[0] for preview in ran[1:]])
    # the velocity changes within the stage, by a tenth of a tick's motion at most
    assert np.abs(ahead - came).max() < 0.2 * largest_step()


def test_a_stride_tilts_its_reference_as_the_body_is_commanded():
    robot = Ideal("walk", AHEAD)
    robot.run(3.0)
    level = np.mean([preview.reference[0] for preview in robot.run(WALK.period)], axis=0)
    robot.scheduler.set_pose(np.array([0.065, 0.08, 0.05]))
    robot.run(3.0)
    tilted = np.mean([preview.reference[0] for preview in robot.run(WALK.period)], axis=0)
    assert tilted[[0, 1]] - level[[0, 1]] == pytest.approx([0.08, 0.05], abs=5e-3)
    assert tilted[5] - level[5] == pytest.approx(0.065 - WALK.height, abs=1e-3)


def test_a_path_asks_no_more_than_the_gait_reaches():
    """Where the path turns by 90 deg the heading along it would change at 1.6 rad/s."""
    corner = Route(np.array([[0.0, 0.0], [0.05, 0.0], [0.05, 0.5]]), "along")
    robot = Ideal("walk", AHEAD, corner)
    robot.run(6.0)
    rates = [preview.reference[0, 8] for preview in robot.previews]
    assert max(np.abs(rates)) <= WALK.forward_steering.rate_max + 1e-9


def test_a_change_of_velocity_keeps_the_phase():
    robot = Ideal("walk", AHEAD)
    before = robot.run(3.0)[-1]
    robot.scheduler.request("walk", np.array([0.0, 0.04, 0.0]))
    after = robot.run(0.033)[0]
    assert after.phase == pytest.approx((before.phase + 0.033 / WALK.period) % 1.0)


def test_a_velocity_command_expires_and_the_robot_stops():
    robot = Ideal("walk", NOTHING)
    robot.run(3.0)
    robot.scheduler.set_velocity(robot.now, AHEAD)
    early = robot.run(GAITS.velocity_timeout)[-1]
    late = robot.run(3.0)
    assert early.command.velocity == pytest.approx(AHEAD)
    assert not late[2].command.velocity.any()
    assert late[-1].reference[0, 9:11] == pytest.approx(0.0)
    assert late[-1].posture
    assert np.ptp(late[-1].tendon_angle, axis=0) == pytest.approx(0.0, abs=1e-12)


def test_a_requested_velocity_does_not_expire():
    robot = Ideal("walk", AHEAD)
    assert robot.run(5.0)[-1].command.velocity == pytest.approx(AHEAD)


@pytest.mark.parametrize("late", [-1.0, 0.52, 10_000.0])
def test_a_command_with_a_stamp_far_from_the_states_stops_the_robot_and_is_refused(late):
    """A stamp from the future might never expire, and an old command may be a late stop."""
    robot = Ideal("walk", AHEAD)
    robot.run(3.0)
    with pytest.raises(
        ConfigError, match=r"stamp is [+-]\d+\.\d{3} s from the state's \(limit 0\.5 s"
    ) as refusal:
        robot.scheduler.set_velocity(robot.now + round(late * SECOND), AHEAD)
    assert "\n" not in str(refusal.value)
    after = robot.run(0.1)  # in which a stamp just too far ahead would come within the limit
    assert not np.any([preview.command.velocity for preview in after])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.request("trot", NOTHING), "no gait 'trot'"),
        (lambda s: s.request("walk", [0.5, 0, 0]), r"v_x = 0\.5: gait walk reaches"),
        (lambda s: s.request("walk", [np.nan, 0, 0]), r"v_x = nan: gait walk reaches"),
        (lambda s: s.set_velocity(SECOND, [0, np.nan, 0]), r"v_y = nan: gait walk reaches"),
        (lambda s: s.set_velocity(SECOND, [0, 0, -9.0]), r"yaw rate = -9: gait walk reaches"),
        (lambda s: s.set_pose([np.nan, 0, 0]), r"height = nan: gait walk reaches"),
        (lambda s: s.set_pose([0.06, 0, 1.0]), r"pitch = 1: gait walk reaches \[-0\.09, 0\.09\]"),
    ],
)
def test_a_refused_command_changes_nothing_and_names_value_and_limit(call, message):
    robot, other = Ideal("walk", AHEAD), Ideal("walk", AHEAD)
    robot.run(2.0)
    other.run(2.0)
    with pytest.raises(ConfigError, match=message) as refusal:
        call(robot.scheduler)
    assert "\n" not in str(refusal.value)
    for mine, theirs in zip(robot.run(1.0), other.run(1.0)):
        assert (mine.tendon_angle == theirs.tendon_angle).all()
        assert (mine.command.velocity == theirs.command.velocity).all()


def test_a_scheduler_with_a_bad_gait_or_velocity_is_not_built():
    with pytest.raises(ConfigError, match="no gait 'trot'"):
        Ideal("trot")
    with pytest.raises(ConfigError, match=r"v_x = 0\.05: gait stand reaches \[0, 0\]"):
        Ideal("stand", AHEAD)


def test_a_request_during_a_blend_waits_for_its_end():
    robot = Ideal("walk", AHEAD)
    robot.run(3.0)
    robot.scheduler.request("stand", NOTHING)
    assert robot.run(0.5)[-1].gait == "stand"
    robot.scheduler.request("walk", AHEAD)
    assert robot.run(0.4)[-1].gait == "stand"
    assert robot.run(0.3)[-1].gait == "walk"


@pytest.mark.parametrize("jump", [-500.0, -0.04, 5.0, 1e4])
def test_a_jump_of_the_clock_neither_moves_the_commands_nor_delays_later_changes(jump):
    robot = Ideal("stand")
    robot.run(2.0)
    robot.scheduler.request("walk", AHEAD)
    before = robot.run(0.3)[-1]
    robot.now += round(jump * SECOND)
    after = robot.run(0.033)[0]
    assert after.tendon_angle[0] == pytest.approx(before.tendon_angle[0], abs=1e-9)
    assert robot.run(3.0)[-1].reference[0, 9] > 0.0
    assert robot.steps.max() < 1.0


def test_a_path_is_followed_instead_of_the_velocity():
    points = np.array([[0.0, 0.0], [0.2, 0.0], [0.2, 0.2]])
    robot = Ideal("walk", AHEAD, Route(points, "kept"))
    robot.run(15.0)
    assert robot.state[3] == pytest.approx(0.2, abs=2 * LEAD)  # this robot knows no feedback
    assert robot.state[4] == pytest.approx(0.2, abs=3 * ARRIVED)
    assert robot.state[2] == pytest.approx(0.0, abs=1e-9)
    assert robot.previews[-1].posture  # it stands at the end


def test_a_path_is_followed_at_the_speed_of_the_command_from_a_posture_on():
    """As the supervisor starts it: it stands with the path, then walking is requested."""
    points = np.array([[0.0, 0.0], [1.0, 0.0]])
    robot = Ideal("stand", NOTHING, Route(points, "kept"))
    robot.run(0.5)
    robot.scheduler.request("walk", AHEAD)
    robot.run(3.0)
    before, strides = robot.state[3], 5 * GAITS.strides["walk"].period
    robot.run(strides)
    assert robot.state[3] - before == pytest.approx(AHEAD[0] * strides, rel=0.05)
    robot.scheduler.request("walk", NOTHING)
    assert robot.run(3.0)[-1].posture  # without velocity it stands, wherever the path leads


def test_a_robot_that_moves_as_its_reference_is_hardly_corrected():
    """The reference leans forward by some 2 deg, which would take an offset of 6 deg to level."""
    robot = Ideal("walk", AHEAD)
    robot.run(10 * GAITS.strides["walk"].period)
    assert math.degrees(GAITS.strides["walk"].mean_posture(AHEAD)[2]) > 1.0
    offset = np.degrees(robot.scheduler._current.feedback.offset)
    assert np.abs(offset).max() < 1.0


def test_while_the_servos_do_not_follow_the_phase_waits_and_nothing_is_corrected():
    robot = Ideal("walk", AHEAD)
    robot.run(3.0)
    robot.scheduler.set_followed(False)
    before = robot.run(0.033)[-1]
    held = robot.run(2.0)[-1]
    assert held.phase == before.phase
    assert not held.command.followed
    assert (held.tendon_angle == held.tendon_angle[0]).all()  # over the horizon too
    robot.scheduler.set_followed(True)
    passed = (robot.run(0.1)[-1].phase - before.phase) % 1.0
    assert passed == pytest.approx(0.1 / held.period, abs=0.02)


def test_a_posture_is_corrected_once_the_servos_have_followed_for_a_while():
    robot = Ideal("stand")
    assert robot.run(1.1)[-1].posture
    robot.scheduler.set_followed(False)
    assert not any(preview.posture for preview in robot.run(1.0))
    robot.scheduler.set_followed(True)
    assert not any(preview.posture for preview in robot.run(SETTLING - 0.1))
    assert robot.run(0.2)[-1].posture


@pytest.mark.parametrize("jump", [-1.0, 2.0])
def test_a_jump_of_the_clock_does_not_enter_the_means_of_a_stride(jump):
    robot = Ideal("walk", AHEAD)
    robot.run(5.0)
    feedback = robot.scheduler._current.feedback
    before = feedback.velocity[0]
    robot.now += round(jump * SECOND)
    robot.run(1.5)
    # of a robot that moves as its reference 1 mm/s; with the jump in it 18 to 50 mm/s
    assert abs(feedback.velocity[0] - before) < 5e-3


@pytest.mark.parametrize("jump", [[0.06, -0.03, 0.0], [0.0, 0.0, 0.2]])
def test_a_jump_of_the_odometry_does_not_enter_the_means_of_a_stride(jump):
    robot = Ideal("walk", AHEAD)
    robot.run(5.0)
    feedback = robot.scheduler._current.feedback
    before = feedback.velocity.copy()
    robot.state[[3, 4, 2]] += jump
    feedback.place += jump  # else the robot rightly returns to its place
    robot.run(1.5)
    # with the jump in it 11 to 37 mm/s, or 0.1 rad/s
    assert np.abs(feedback.velocity - before).max() < 5e-3


def test_everything_commanded_can_be_set_from_a_recorded_preview():
    robot, replayed = Ideal("stand"), GaitScheduler(GAITS, ROBOT, SPRINGS, "stand", NOTHING)
    robot.run(0.5)
    robot.scheduler.request("walk", AHEAD)
    robot.run(3.0)
    robot.scheduler.set_velocity(robot.now, np.array([0.0, 0.03, 0.05]))
    robot.scheduler.set_pose(np.array([0.06, 0.0, 0.0]))
    robot.run(2.0)
    robot.scheduler.request("sit", NOTHING)
    robot.run(2.0)
    current = state()
    for k, preview in enumerate(robot.previews):
        replayed.set_command(preview.command)
        again = replayed.step(SECOND + k * TICK, current)
        assert (again.tendon_angle == preview.tendon_angle).all()
        assert (again.reference[:, 5] == preview.reference[:, 5]).all()
        v = again.reference[0, [9, 10, 8]] if again.gait == "walk" else np.zeros(3)
        current[[3, 4, 2]] += v * TICK * 1e-9
        current[[5, 0, 1]] = again.reference[0, [5, 0, 1]]


@pytest.mark.parametrize(
    "command",
    [
        GaitCommand("trot", NOTHING, np.array([0.04, 0.0, 0.0])),
        GaitCommand("walk", np.full(3, 9.0), np.array([0.06, 0.0, 0.0])),
    ],
)
def test_a_recorded_command_that_is_out_of_range_is_refused(command):
    with pytest.raises(ConfigError):
        GaitScheduler(GAITS, ROBOT, SPRINGS, "stand", NOTHING).set_command(command)
