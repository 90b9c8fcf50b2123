"""Slack and broken tendons are detected from the servos' torque, without false alarms."""

import math

import numpy as np
import pytest
from real_graph import changed_config
from supervisor_bench import HEIGHT, LOAD, ROBOT

from slot_core.gait.gait import read_gaits
from slot_core.robot import LEGS
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import State
from slot_core.safety.tendon_watch import read_tendon_watch
from slot_core.simulation.supervised_loop import SupervisedLoop
from slot_lab.leg_tests.leg_map import StaticLeg

LIMITS = read_supervisor().tendon
RADIUS = ROBOT.tendon.spool_radius
TICK = 10_000_000  # ns, /joint_states
STRIDE = read_gaits().strides["walk"].period
HEIGHTS = np.full(4, HEIGHT)


def feed(
    watch,
    seconds,
    slack=(0.0, 0.0, 0.0, 0.0),
    *,
    start=0,
    stiffness=1,
    swing=0.4,
):
    """Feed a stride's readings, each leg with its slack (m); returns the last time and state."""
    for stamp in range(start + TICK, start + round(seconds * 1e9) + 1, TICK):
        phase = stamp * 1e-9 / STRIDE * math.tau
        angle = 1.2 + swing * np.sin(phase + np.arange(4))
        torque, _ = LOAD(angle - np.array(slack) / RADIUS, HEIGHTS)
        torque *= stiffness
        state = watch.observe(stamp, angle, torque, HEIGHTS, STRIDE)
    return stamp, state


def watch():
    return read_tendon_watch(ROBOT, LIMITS)


@pytest.mark.parametrize(
    ("angle_deg", "height"), [(45.0, 0.04), (95.0, 0.0625)]
)
def test_the_tabulated_torque_is_that_of_the_static_leg_with_the_simulators_nodes(
    angle_deg, height
):
    leg, angle = StaticLeg(ROBOT, 22), math.radians(angle_deg)
    for part in np.linspace(0.0, angle, 30):
        here = leg.solve(part, height)
    torque, _ = LOAD(np.array([angle]), np.array([height]))
    # 61 nodes against 22, and linear between angles 5 deg apart
    assert torque[0] == pytest.approx(here.tension * RADIUS, rel=0.02, abs=0.01)


@pytest.mark.parametrize("leg", range(4))
def test_a_tendon_3_mm_longer_is_measured_and_named_until_a_reset(leg):
    slack, watched = np.zeros(4), watch()
    slack[leg] = 3e-3
    stamp, state = feed(watched, 2.0, slack)
    assert state.damaged.tolist() == [i == leg for i in range(4)]
    assert state.message.startswith(f"slack or broken tendon {LEGS[leg]} (")
    assert state.message.endswith("limit 1.4 mm")
    # the slope is taken at the angle, the torque 17 deg below, where the slope is a little smaller
    assert state.slack[leg] == pytest.approx(3e-3, rel=0.1)
    assert np.delete(state.slack, leg) == pytest.approx(0.0, abs=1e-9)
    bad = np.array([1.0, math.nan, math.inf, 1.0])  # is ignored
    ignored = watched.observe(stamp + TICK, bad, np.ones(4), HEIGHTS, STRIDE)
    assert ignored.slack.tolist() == state.slack.tolist()
    _, state = feed(watched, 2.0, start=stamp)
    assert state.damaged[leg]
    watched.reset()
    assert not watched.state.damaged.any()


def test_slack_is_unknown_before_a_whole_stride_without_a_late_reading_or_a_gap():
    watched, start = watch(), 0
    for age, gap in ((1.01 * LIMITS.age_max, 0), (0.0, 100_000_000), (0.0, 0)):
        stamp, state = feed(watched, STRIDE - 0.02, [0.01] * 4, start=start)
        assert np.isnan(state.slack).all()
        assert not state.damaged.any()
        watched.observe(stamp + 1, *np.ones((3, 4)), STRIDE, age=age)
        start = stamp + gap
    _, state = feed(watched, 2.0, [0.01] * 4, start=start)
    assert state.damaged.all()


def test_two_damaged_tendons_are_both_named_but_not_neighbours_that_carry_less_because_of_one():
    _, state = feed(watch(), 2.0, [0.006, 0.0, 0.005, 0.0])
    assert state.damaged.tolist() == [True, False, True, False]
    _, state = feed(watch(), 2.0, [0.006, 0.0028, 0.0, 0.0])
    assert (state.slack[:2] > LIMITS.slack_max).all()
    assert state.damaged.tolist() == [True, False, False, False]


def test_slack_behind_with_as_much_less_in_front_is_a_shifted_load_up_to_the_limit():
    for behind, damaged in ((0.0015, False), (0.0045, True)):
        _, state = feed(watch(), 2.0, [-0.0015, -0.0015, behind, behind])
        assert state.damaged.tolist() == [False, False, damaged, damaged]


@pytest.mark.parametrize(
    ("swing", "slack", "damaged"),
    [(0.0, 0.0035, False), (0.4, 0.0035, True), (0.0, 0.006, True)],
)
def test_in_a_posture_diagonals_apart_are_friction_of_the_guides_up_to_the_limit(
    swing, slack, damaged
):
    _, state = feed(watch(), 2.0, [0, slack, slack, 0], swing=swing)
    assert state.damaged.tolist() == [False, damaged, damaged, False]


def test_a_moment_of_slack_raises_no_alarm_and_the_same_slack_for_longer_does():
    """Twice beyond the limit for a moment, by less than `excess_max` in sum; then for good."""
    watched, stamp, highest = watch(), 0, []
    for _ in range(2):
        stamp, _ = feed(watched, 2.0, start=stamp)
        stamp, state = feed(watched, 0.4, [0.003, 0, 0, 0], start=stamp)
        highest.append(state.slack.max())
        stamp, state = feed(watched, 0.2, [-0.012, 0, 0, 0], start=stamp)
    assert min(highest) > LIMITS.slack_max
    assert not state.damaged.any()
    _, state = feed(watched, 2.0, [0.003, 0, 0, 0], start=stamp)
    assert state.damaged[0]


@pytest.mark.parametrize("stiffness", [0.65, 1.0, 1.5])
def test_legs_that_are_all_softer_or_stiffer_are_no_torn_tendons_but_a_torn_one_is_named(
    stiffness,
):
    """Less than half the table's stiffness is beyond `shared`: no print explains it."""
    watched = watch()
    stamp, state = feed(watched, 3.0, stiffness=stiffness)
    assert not state.damaged.any()
    assert state.slack == pytest.approx(0.0, abs=1e-9)
    assert state.stiffness == pytest.approx(stiffness)
    _, state = feed(
        watched, 2.0, [0.0, 0.1, 0.0, 0.0], start=stamp, stiffness=stiffness
    )
    assert state.damaged.tolist() == [False, True, False, False]
    _, state = feed(watch(), 2.0, stiffness=0.4)
    assert state.damaged.all()


@pytest.mark.parametrize(
    "scene", ["flat", "slippery", "split", "uneven", "payload", "push"]
)
def test_commands_of_an_undamaged_walk_pass_unchanged_without_an_alarm(scene):
    """The push is at 5 s. Largest slack inferred in 22 s: 0.57 mm, and 0.66 mm at 20 deg."""
    loop = SupervisedLoop(scene, "walk", None, 0)
    list(loop.run(1.0))
    for report in loop.run(7.0):
        assert report.state is State.WALKING
        # of the payload's scene: it is no alarm
        assert all("more load" in line for line in report.warnings)
        assert not loop.servos.report().health.slewed.any()
    assert np.nanmax(report.slack) < 0.75 * LIMITS.slack_max


KILOGRAM = {"scene.payload.mass": 1.0}


@pytest.mark.parametrize(
    ("scene", "changes"),
    [("slope10", {}), ("flat", KILOGRAM), ("slope5", KILOGRAM)],
)
def test_a_walk_up_a_slope_or_with_a_payload_raises_no_alarm(scene, changes):
    """The front and the rear legs carry unlike shares; on the slope that looks like 1.5 mm."""
    loop = SupervisedLoop(
        scene, "walk", np.array([0.05, 0.0, 0.0]), 0, changes=changes
    )
    reports = list(loop.run(12.0))
    assert {report.state for report in reports[100:]} == {State.WALKING}


def test_a_robot_that_is_told_of_its_broken_tendon_walks_on_three_legs(
    tmp_path, monkeypatch
):
    """Untold, it holds after .58 s."""
    broken = [True, False, False, False]
    changes = {
        "supervisor": {"tendon.broken": broken},
        "rollout_mpc": {"nominal.broken": broken},
        "scene/tendon_breaks": {"faults.fl.time": 0.0},
    }
    monkeypatch.setenv("SLOT_CONFIG", str(changed_config(tmp_path, changes)))
    loop = SupervisedLoop("tendon_breaks", "walk", None, 0)
    for report in loop.run(12.0):
        assert report.state is not State.HOLD, report.reason
    assert report.state is State.WALKING
    assert loop.plant.robot.position[0] > 0.1


@pytest.mark.parametrize("begin", [3.0, 3.26, 3.312, 3.572])
def test_a_walk_that_goes_on_after_a_short_hold_raises_no_alarm(begin):
    """The torso tilts by up to 19 deg while the legs return to the gait at a limited rate."""
    loop = SupervisedLoop("flat", "walk", None, 0)
    list(loop.run(begin))
    loop.running.remove("force_mapper")
    list(loop.run(0.13))
    loop.running.add("force_mapper")
    states = [report.state for report in loop.run(4.0)]
    assert State.HOLD in states
    assert set(states[-100:]) == {State.WALKING}


@pytest.mark.parametrize("modulus", [0.65, 1.5])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_torn_tendon_is_named_within_a_second_on_legs_of_another_print(
    modulus, seed
):
    """Standing; before it the softer legs themselves were four torn tendons."""
    changes = {"robot.leg.young_modulus": modulus * ROBOT.leg.young_modulus}
    loop = SupervisedLoop("flat", "stand", None, seed, changes=changes)
    assert State.HOLD not in {report.state for report in loop.run(4.0)}
    loop.plant.robot.damage_tendon(1, broken=True)
    *_, report = loop.run(1.0)
    assert report.reason.startswith("slack or broken tendon FR (")
