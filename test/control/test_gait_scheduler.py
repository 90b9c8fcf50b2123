"""Gait scheduler: rates, blends, body poses, the preview; commands, refusals, paths, jumps.

Path: points of a polyline, its ends, and the reference place that waits for the robot.
"""

import itertools
import math

import numpy as np
import pytest

from slot_core.clock import SECOND
from slot_core.config import ConfigError
from slot_core.control.force_map import read_springs
from slot_core.gait.gait import GaitCommand, read_gaits
from slot_core.gait.gait_scheduler import SETTLING, GaitScheduler
from slot_core.gait.route import (
    ARRIVED,
    CREEP,
    LEAD,
    TURN_GAIN,
    Route,
    read_route,
)
from slot_core.geometry import rotate
from slot_core.legs.leg_table import stiffness_ratio
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor

ROBOT, GAITS = read_robot(), read_gaits()
SPRINGS = read_springs()
WALK = GAITS.strides["walk"]
TICK = 33_000_000  # ns
NOTHING = np.zeros(3)
AHEAD = np.array([0.05, 0.0, 0.0])
CENTRE = np.radians(WALK.centre_deg)[0]


class Ideal:
    """A robot that moves exactly as its reference says, after `seconds` of ticks."""

    def __init__(
        self,
        gait="stand",
        velocity=NOTHING,
        path=None,
        seconds=0.0,
        leg_stiffness=1.0,
    ):
        self.scheduler = GaitScheduler(
            GAITS, ROBOT, SPRINGS, gait, velocity, path
        )
        self.now, self.state, self.previews = SECOND, 0.06 * np.eye(12)[5], []
        self.leg_stiffness = leg_stiffness
        self.run(seconds)

    def run(self, seconds):
        """Previews of the ticks of that time."""
        ran = []
        for _ in range(round(seconds * SECOND / TICK)):
            ran.append(
                self.scheduler.step(self.now, self.state, self.leg_stiffness)
            )
            reference = ran[-1].reference[0]
            v = (
                reference[[9, 10, 8]]
                if ran[-1].gait in GAITS.strides
                else np.zeros(3)
            )
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


def stands(preview):
    """Whether the legs are loaded, corrected and at rest over the horizon."""
    moves = np.ptp(preview.tendon_angle, axis=0).max()
    return preview.corrected and bool(moves < 1e-12)


# The fastest stride without a blend, at the largest velocities that it reaches one at a time.
def largest_step():
    phase, ahead = np.linspace(0, 1, 500), TICK * 1e-9 / WALK.period
    return max(
        np.ptp(
            [WALK.stride_table(p, v)[:, :4] for p in (phase, phase + ahead)],
            axis=0,
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
    robot = Ideal(
        first.split()[0], AHEAD if first == "walk" else NOTHING, seconds=4.0
    )
    robot.scheduler.request(
        second.split()[0], AHEAD if second == "walk" else NOTHING
    )
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
    force = SPRINGS.at(
        last.tendon_angle[0], ROBOT.clamp_heights(*(pose or home))
    ).force
    assert force == pytest.approx(ROBOT.weight / 4, abs=1e-9)
    assert last.normal_force[0] == pytest.approx(force)
    assert stands(last)
    assert last.contact.all()


def reached(name, share):
    """Velocity that a gait reaches when a share (3,) of its largest ones is commanded."""
    return GAITS.clipped(name, share * np.array(GAITS.find(name).speeds))[0]


def test_no_sequence_of_commands_asks_for_more_than_the_final_check_lets_pass():
    """Random requests, velocities and poses for two minutes, at the limits of each.

    Everything commanded can be set again from the recorded previews.
    """
    rng, robot = np.random.default_rng(6), Ideal()
    for _ in range(60):
        kind, gait = rng.integers(3), str(rng.choice(sorted(GAITS.gaits)))
        present = robot.scheduler._requested
        if kind == 0:
            robot.scheduler.request(
                gait, reached(gait, rng.uniform(-1.0, 1.0, 3))
            )
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
    # NaN is not
    assert 0.0 <= angle.min() <= angle.max() <= ROBOT.tendon.angle_max
    assert min(preview.normal_force.min() for preview in robot.previews) >= 0.0
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
    assert after[0].phase == pytest.approx(
        (before.phase + 0.033 / WALK.period) % 1.0
    )
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
    assert early[0].tendon_angle[3:] == pytest.approx(
        later.tendon_angle[:-3], abs=1e-9
    )
    assert early[0].reference[3:, :2] == pytest.approx(
        later.reference[:-3, :2], abs=1e-9
    )
    assert (early[0].contact[3:] == later.contact[:-3]).all()


@pytest.mark.parametrize(
    ("first", "second"),
    [("walk", "stand"), ("walk", "fast_walk"), ("stand", "walk")],
)
def test_the_preview_of_a_blend_is_that_of_the_next_ticks(first, second):
    robot = Ideal(first, AHEAD if first != "stand" else NOTHING, seconds=4.0)
    robot.scheduler.request(second, AHEAD if second != "stand" else NOTHING)
    angle = np.array(
        [preview.tendon_angle for preview in robot.run(GAITS.transition)]
    )
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


# --- commands ---

FASTER = GaitCommand("walk", np.full(3, 9.0), np.array([0.06, 0.0, 0.0]))


def test_a_velocity_command_expires_and_the_robot_stops_but_a_requested_velocity_does_not():
    robot = Ideal("walk", AHEAD)
    assert robot.run(5.0)[-1].command.velocity == pytest.approx(AHEAD)
    robot.scheduler.set_velocity(robot.now, AHEAD)
    early = robot.run(GAITS.velocity_timeout)[-1]
    assert early.command.velocity == pytest.approx(AHEAD)
    late = robot.run(3.0)
    assert not late[2].command.velocity.any()
    assert late[-1].reference[0, 9:11] == pytest.approx(0.0)
    assert stands(late[-1])


@pytest.mark.parametrize("late", [-1.0, 0.52, 10_000.0])
def test_a_command_with_a_stamp_far_from_the_states_stops_the_robot_and_is_refused(
    late,
):
    """A stamp from the future might never expire, and an old command may be a late stop."""
    robot = Ideal("walk", AHEAD, seconds=3.0)
    message = r"stamp is [+-]\d+\.\d{3} s from the state's \(limit 0\.5 s"
    with pytest.raises(ConfigError, match=message):
        robot.scheduler.set_velocity(robot.now + round(late * SECOND), AHEAD)
    # in this time a stamp just too far ahead would come within the limit
    after = robot.run(0.1)
    assert not np.any([preview.command.velocity for preview in after])


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda s: s.request("trot", NOTHING), "no gait 'trot'"),
        (lambda s: s.set_command(FASTER), r"v_x = 9: gait walk reaches"),
        (
            lambda s: s.request("walk", [0, 0, -9.0]),
            r"yaw rate = -9: gait walk reaches",
        ),
        (
            lambda s: s.set_velocity(SECOND, [0, np.inf, 0]),
            r"velocity \[ 0. inf 0.\]: expected",
        ),
        (
            lambda s: s.set_pose([0.06, 0, 1.0]),
            r"pitch = 1: gait walk reaches \[-0\.09, 0\.09\]",
        ),
    ],
)
def test_a_refused_command_changes_nothing_and_names_value_and_limit(
    call, message
):
    robot, other = (Ideal("walk", AHEAD, seconds=2.0) for _ in range(2))
    with pytest.raises(ConfigError, match=message):
        call(robot.scheduler)
    for mine, theirs in zip(robot.run(1.0), other.run(1.0)):
        assert (mine.tendon_angle == theirs.tendon_angle).all()
        assert (mine.command.velocity == theirs.command.velocity).all()


@pytest.mark.parametrize("gait", GAITS.strides)
def test_a_velocity_beyond_the_reach_is_clipped_to_it_in_the_same_direction(
    gait,
):
    rng = np.random.default_rng(0)
    axes = 10.0 * np.vstack([np.eye(3), -np.eye(3)])
    random = rng.normal(size=(200, 3)) * [0.1, 0.1, 0.5]
    for wanted in np.vstack(
        [axes, random, 1e6 * random[:3], [[0.5, 0.0, 1.0]]]
    ):
        given, remark = GAITS.clipped(gait, wanted)
        GAITS.require_velocity(gait, given)
        share = np.linalg.norm(given) / np.linalg.norm(wanted)
        assert given == pytest.approx(share * wanted, rel=1e-12)
        assert bool(remark) == (share < 1.0)
        if remark:
            with pytest.raises(ConfigError, match="reaches"):
                GAITS.require_velocity(gait, 1.0001 * given)
        else:
            assert (given == wanted).all()


def test_a_clipped_velocity_is_said_while_it_is_in_force():
    robot = Ideal("walk", AHEAD, seconds=2.0)
    # of teleop_twist_keyboard
    robot.scheduler.set_velocity(robot.now, [0.5, 0.0, 1.0])
    clipped, *_, expired = robot.run(GAITS.velocity_timeout + 0.2)
    v_x = clipped.command.velocity[0]
    said = f"velocity clipped to the reach of gait walk: v_x 0.5 to {v_x:.3g}, yaw rate 1 to"
    assert clipped.remark.startswith(said)
    assert expired.remark == ""


def test_a_request_during_a_blend_waits_for_its_end():
    robot = Ideal("walk", AHEAD, seconds=3.0)
    robot.scheduler.request("stand", NOTHING)
    assert robot.run(0.5)[-1].gait == "stand"
    robot.scheduler.request("walk", AHEAD)
    later = robot.run(0.7)
    assert (later[11].gait, later[-1].gait) == ("stand", "walk")


@pytest.mark.parametrize("jump", [-500.0, -0.04, 5.0, 1e4])
def test_a_jump_of_the_clock_neither_moves_the_commands_nor_delays_later_changes(
    jump,
):
    robot = Ideal("stand", seconds=2.0)
    robot.scheduler.request("walk", AHEAD)
    before = robot.run(0.3)[-1]
    robot.now += round(jump * SECOND)
    assert robot.run(0.033)[0].tendon_angle[0] == pytest.approx(
        before.tendon_angle[0], abs=1e-9
    )
    assert robot.run(3.0)[-1].reference[0, 9] > 0.0
    assert robot.steps.max() < 1.0


def test_a_path_is_followed_at_the_speed_of_the_command_from_a_posture_on():
    """As the supervisor starts it: it stands with the path, then walking is requested."""
    points = np.array([[0.0, 0.0], [1.0, 0.0]])
    robot = Ideal("stand", NOTHING, Route(points, "kept"), seconds=0.5)
    robot.scheduler.request("walk", AHEAD)
    robot.run(3.0)
    before, strides = robot.state[3], 5 * WALK.period
    robot.run(strides)
    assert robot.state[3] - before == pytest.approx(
        AHEAD[0] * strides, rel=0.05
    )
    # without velocity it stands, wherever the path leads
    robot.scheduler.request("walk", NOTHING)
    assert stands(robot.run(3.0)[-1])


def test_a_path_asks_no_more_than_the_gait_reaches():
    """Where the path turns by 90 deg the heading along it would change at 1.6 rad/s."""
    corner = Route(np.array([[0.0, 0.0], [0.05, 0.0], [0.05, 0.5]]), "along")
    robot = Ideal("walk", AHEAD, corner, seconds=6.0)
    rates = [preview.reference[0, 8] for preview in robot.previews]
    assert max(np.abs(rates)) <= WALK.forward_steering.rate_max + 1e-9


def test_while_the_servos_do_not_follow_a_stride_stands_and_nothing_is_corrected():
    robot = Ideal("walk", AHEAD, seconds=3.0)
    robot.scheduler.set_followed(False)
    before, *_, held = robot.run(2.0)
    assert held.phase == before.phase
    assert not held.command.followed
    assert not held.corrected
    # over the horizon too
    assert held.tendon_angle == pytest.approx(CENTRE, abs=0.01)
    robot.scheduler.set_followed(True)
    moving = robot.run(SETTLING - 0.1)
    # it blends
    assert moving[0].tendon_angle[0] == pytest.approx(CENTRE, abs=0.05)
    assert not any(preview.corrected for preview in moving)
    passed = (moving[2].phase - before.phase) % 1.0
    assert passed == pytest.approx(0.1 / held.period, abs=0.02)
    assert robot.run(0.2)[-1].corrected


def test_slack_legs_are_without_angle_contact_and_correction():
    robot = Ideal("lie", seconds=4.0)
    lying = robot.previews[-1]
    assert not np.any([lying.tendon_angle, lying.contact])
    assert not lying.corrected
    robot.scheduler.request("stand", NOTHING)
    assert not any(preview.corrected for preview in robot.run(0.5))
    assert robot.run(2.0)[-1].corrected


@pytest.mark.parametrize("place", [[0.06, -0.03, 0.0], [0.0, 0.0, 0.4]])
def test_the_reference_stays_near_the_robot_and_begins_anew_after_a_jump(place):
    robot = Ideal("walk", AHEAD, seconds=5.0)
    robot.state[[3, 4, 2]] += place
    gap = robot.run(0.033)[0].reference[0, [3, 4, 2]] - robot.state[[3, 4, 2]]
    assert np.hypot(*gap[:2]) < GAITS.lead + 0.01  # of the sway
    assert abs(gap[2]) <= GAITS.heading_lead


def test_the_reference_place_stays_while_a_stride_comes_to_rest():
    """The legs unwind meanwhile, which moves the robot."""
    robot = Ideal("walk", AHEAD, seconds=5.0)
    robot.scheduler.request("walk", NOTHING)
    robot.run(AHEAD[0] / GAITS.acceleration + 0.1)
    place = robot.state[3]
    for moved in np.linspace(0.002, 0.01, 5):
        robot.state[3] = place + moved
        reference = robot.run(0.033)[0].reference[0]
        assert reference[3] == pytest.approx(place, abs=0.001)
    robot.run(GAITS.transition)
    assert robot.previews[-1].reference[0, 3] == robot.state[3]


@pytest.mark.parametrize("ratio", [0.65, 0.8, 1.0, 1.5])
def test_a_posture_on_legs_of_another_stiffness_carries_the_robot_without_a_jerk(
    ratio,
):
    robot = Ideal(leg_stiffness=ratio)
    last = robot.run(3.0)[-1]
    assert robot.steps.max() < 0.03  # rad a tick: 1 rad/s
    pose = last.reference[0][[5, 0, 1]]
    assert stiffness_ratio(
        ROBOT, SPRINGS, last.tendon_angle[0], pose
    ) == pytest.approx(ratio, rel=1e-6)
    assert last.normal_force[0].sum() == pytest.approx(ROBOT.weight)


def test_a_walk_on_soft_legs_is_lower_and_slower_and_says_so():
    last = Ideal("walk", AHEAD, leg_stiffness=0.7).run(5.0)[-1]
    share = (0.7 - GAITS.soft[0]) / (GAITS.soft[1] - GAITS.soft[0])
    fastest = share * WALK.forward.speed
    assert last.velocity_ahead[-1][0] == pytest.approx(fastest, rel=1e-3)
    assert last.remark.startswith("velocity clipped to 55%: legs carry 0.70")
    assert last.reference[:, 5].mean() < WALK.height - 0.01


L_SHAPE = np.array([[0.0, 0.0], [0.3, 0.0], [0.3, 0.2]])
DT = 0.033
SPEED = 0.05  # m/s


def state(x=0.0, y=0.0, yaw=0.0):
    row = np.zeros(12)
    row[[3, 4, 2]] = x, y, yaw
    return row


def follow(path, seconds, robot):
    """Places (n, 3) of a robot that goes to the reference place at once, without turning."""
    places = []
    for _ in range(round(seconds / DT)):
        places.append(path.place(robot, DT, SPEED))
        robot[[3, 4]] = places[-1][:2]
    return np.array(places)


def test_the_reference_travels_at_the_speed_along_the_polyline_of_a_file(
    tmp_path,
):
    """Points that repeat are one point."""
    file = tmp_path / "path.csv"
    file.write_text(
        "y,x,note\n0,0,start\n0,0,start\n0,0.3,corner\n0.2,0.3,end\n"
    )
    path = read_route(file, "kept")
    assert path.length == pytest.approx(0.5)
    places = follow(path, 12.0, state(yaw=0.4))
    travelled = np.minimum(SPEED * DT * np.arange(1, len(places) + 1), 0.5)
    expected = [(s, 0.0) if s <= 0.3 else (0.3, s - 0.3) for s in travelled]
    np.testing.assert_allclose(places[:, :2], expected, atol=1e-9)
    assert set(places[:, 2]) == {0.4}
    assert path.place(state(0.3, 0.1, yaw=1.2), DT, SPEED)[2] == 0.4


@pytest.mark.parametrize(
    "place", [(0.0, 0.0), (0.2, 0.0), (0.0, 0.2), (-0.01, -0.3)]
)
def test_the_reference_waits_only_for_a_robot_that_is_behind_it_along_the_path(
    place,
):
    """It would stay where it is, and the robot would go on along the first side for ever."""
    path = Route(L_SHAPE, "kept")
    places = [path.place(state(*place), DT, SPEED) for _ in range(100)]
    expected = min(SPEED * DT * 100, place[0] + LEAD)
    # one step beyond, since it stops once it is that far
    assert expected - 1e-9 <= places[-1][0] <= expected + SPEED * DT


def test_a_robot_that_lags_slows_down_before_the_end_and_stops_at_it():
    path = Route(L_SHAPE, "kept")
    follow(path, 20.0, state())
    expected = {0.1: 1.0, LEAD: 1.0, LEAD / 2: 0.5, 0.006: CREEP}
    for left, share in expected.items():
        velocity = path.velocity(state(0.3, 0.2 - left), SPEED)
        assert velocity == pytest.approx([0.0, share * SPEED, 0.0])
    # noise does not start it again
    for place in ((0.29, 0.2 - ARRIVED / 2), (0.29, 0.18)):
        assert not path.velocity(state(*place), SPEED).any()


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_the_velocity_is_along_the_path_in_the_frame_of_the_robot(yaw):
    path = Route(L_SHAPE, "kept")
    path.place(state(yaw=yaw), DT, SPEED)
    *velocity, rate = path.velocity(state(yaw=yaw), SPEED)
    assert rotate(np.array(velocity), yaw) == pytest.approx([SPEED, 0.0])
    assert rate == 0.0


def test_a_heading_along_the_path_turns_with_it_the_short_way_round():
    headings = follow(Route(L_SHAPE, "along"), 13.0, state(yaw=-0.2))[:, 2]
    assert headings[0] == 0.0
    assert headings[-1] == pytest.approx(math.pi / 2)
    west = np.array([[0.0, 0.0], [-1.0, 1e-9]])  # heading just below pi
    for points, yaw, error in (
        (L_SHAPE, -0.2, 0.2),
        (west, -3.1, 3.1 - math.pi),
    ):
        path = Route(points, "along")
        path.place(state(), DT, SPEED)
        rate = path.velocity(state(yaw=yaw), SPEED)[2]
        assert rate == pytest.approx(error * TURN_GAIN, abs=1e-6)


NO_PATH, TOO_SHORT = (
    "no path with columns x, y: ",
    "needs at least two different points",
)
FAR = r"a value not within \+-1e\+06 m"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (None, NO_PATH),
        (b"", TOO_SHORT),
        (bytes(range(256)), "no path"),
        (b"x,z\n0,0\n1,1\n", f"{NO_PATH}'y'"),
        (b"x,y\n0,0\n1,far\n", f"{NO_PATH}could not convert"),
        (b"x,y\n0,0\n1\n", NO_PATH),
        (b"x,y\n0,0\ninf,1\n", FAR),
        (b"x,y\n0,0\nnan,1\n", FAR),
        (b"x,y\n0,0\n1e308,1\n", FAR),
        (b"x,y\n1,2\n1,2\n1,2\n", TOO_SHORT),
        (b'x,y\n0,"' + 200_000 * b"9" + b'"\n', f"{NO_PATH}field larger"),
    ],
)
def test_a_file_that_is_no_path_is_refused_in_one_line(
    tmp_path, content, message
):
    file = tmp_path / "path.csv"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(ConfigError, match=message) as refusal:
        read_route(file, "kept")
    assert "\n" not in str(refusal.value)
    with pytest.raises(
        ConfigError, match="path_heading = 'sideways': expected one of"
    ):
        read_route(file, "sideways")
