"""Commands of the gait scheduler: expiry, refusals, paths, jumps, servos that do not follow."""

import numpy as np
import pytest
from ideal_robot import AHEAD, GAITS, NOTHING, WALK, Ideal, stands

from slot_core.clock import SECOND
from slot_core.config import ConfigError
from slot_core.gait.gait import GaitCommand
from slot_core.gait.gait_scheduler import SETTLING
from slot_core.gait.route import Route

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
def test_a_refused_command_changes_nothing_and_names_value_and_limit(call, message):
    robot, other = (Ideal("walk", AHEAD, seconds=2.0) for _ in range(2))
    with pytest.raises(ConfigError, match=message):
        call(robot.scheduler)
    for mine, theirs in zip(robot.run(1.0), other.run(1.0)):
        assert (mine.tendon_angle == theirs.tendon_angle).all()
        assert (mine.command.velocity == theirs.command.velocity).all()


@pytest.mark.parametrize("gait", GAITS.strides)
def test_a_velocity_beyond_the_reach_is_clipped_to_it_in_the_same_direction(gait):
    rng = np.random.default_rng(0)
    axes = 10.0 * np.vstack([np.eye(3), -np.eye(3)])
    random = rng.normal(size=(200, 3)) * [0.1, 0.1, 0.5]
    for wanted in np.vstack([axes, random, 1e6 * random[:3], [[0.5, 0.0, 1.0]]]):
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
    robot.scheduler.set_velocity(robot.now, [0.5, 0.0, 1.0])  # of teleop_twist_keyboard
    clipped, *_, expired = robot.run(GAITS.velocity_timeout + 0.2)
    v_x = clipped.command.velocity[0]
    said = f"velocity clipped to the reach of gait walk: v_x 0.5 to {v_x:.3g}, yaw rate 1 to"
    assert clipped.remark.startswith(said)
    assert expired.remark == ""
    robot.scheduler.request("stand", NOTHING)
    robot.scheduler.set_velocity(robot.now, [0.02, 0.0, 0.0])
    standing = robot.run(0.033)[-1]
    assert standing.remark.endswith("gait stand: v_x 0.02 to 0")
    robot.scheduler.request("stand", NOTHING)
    assert robot.run(0.033)[-1].remark == ""


@pytest.mark.parametrize("jump", [-500.0, -0.04, 5.0, 1e4])
def test_a_jump_of_the_clock_neither_moves_the_commands_nor_delays_later_changes(jump):
    robot = Ideal("stand", seconds=2.0)
    robot.scheduler.request("walk", AHEAD)
    before = robot.run(0.3)[-1]
    robot.now += round(jump * SECOND)
    after = robot.run(0.033)[0]
    assert after.tendon_angle[0] == pytest.approx(before.tendon_angle[0], abs=1e-9)
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
    assert robot.state[3] - before == pytest.approx(AHEAD[0] * strides, rel=0.05)
    # without velocity it stands, wherever the path leads
    robot.scheduler.request("walk", NOTHING)
    assert stands(robot.run(3.0)[-1])


def test_a_path_asks_no_more_than_the_gait_reaches():
    """Where the path turns by 90 deg the heading along it would change at 1.6 rad/s."""
    corner = Route(np.array([[0.0, 0.0], [0.05, 0.0], [0.05, 0.5]]), "along")
    robot = Ideal("walk", AHEAD, corner, seconds=6.0)
    rates = [preview.reference[0, 8] for preview in robot.previews]
    assert max(np.abs(rates)) <= WALK.forward_steering.rate_max + 1e-9


def test_while_the_servos_do_not_follow_the_phase_waits_and_nothing_is_corrected():
    robot = Ideal("walk", AHEAD, seconds=3.0)
    robot.scheduler.set_followed(False)
    before, *_, held = robot.run(2.0)
    assert held.phase == before.phase
    assert not held.command.followed
    assert not held.corrected
    assert (held.tendon_angle == held.tendon_angle[0]).all()  # over the horizon too
    robot.scheduler.set_followed(True)
    moving = robot.run(SETTLING - 0.1)
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
