"""Supervisor: every fault in its time limit, and what leads on from it."""

import math

import numpy as np
import pytest
from supervisor_bench import (
    CYCLE,
    HEIGHT,
    STEP,
    SupervisorBench,
    bench_in,
    health,
    load,
    state,
)

from slot_core.control.policy import Status
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.mpc.settings import read_mpc
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action, Request, State
from slot_core.safety.supervisor import SteadyClock

SETTINGS = read_supervisor()
TIMING = SETTINGS.timing
RELAX_TIME = SETTINGS.gate.relax_time
OFF = (State.IDLE, State.ESTOP, State.FAULT)


@pytest.fixture
def walking():
    return bench_in(State.WALKING)


def ends_in_fault(bench):
    """Whether RELAX slackens the tendons and ends in FAULT, where torque stays off."""
    goal = bench.goals.angle.max()
    took = bench.time_until(State.FAULT, RELAX_TIME + 2 * STEP)
    end = bench.goals.angle.max()
    return (
        took < math.inf
        and end < goal
        and bench.run(2.0).state is State.FAULT
        and not any(bench.torque_on[-200:])
    )


def test_stand_requested_in_hold_ends_in_standing(walking):
    walking.silent.add("command")
    walking.time_until(State.HOLD, 1.0)
    walking.request(Request.STAND)
    walking.silent.clear()
    assert walking.time_until(State.STANDING, 1.0) < 1.0
    assert not walking.reports[-1].resumed  # it walked before


def test_a_robot_held_while_it_stands_resumes_standing():
    bench = bench_in(State.STANDING)
    assert not bench.tick().resumed
    bench.silent.add("command")
    bench.time_until(State.HOLD, 1.0)
    bench.silent.clear()
    assert bench.time_until(State.STANDING, 1.0) < 1.0
    assert bench.reports[-1].resumed


@pytest.mark.parametrize(
    "bad", [Validity.ODOMETRY_REJECTED, Validity.INITIALISING, "NaN"]
)
def test_the_fourth_unusable_estimate_in_a_row_ends_in_hold(walking, bad):
    if bad == "NaN":
        walking.state = np.full(12, math.nan)
    else:
        walking.validity = bad
    before = len(walking.reports)
    took = walking.time_until(State.HOLD, 1.0)
    assert 3 * CYCLE < took <= 4 * CYCLE + STEP
    states = [r.state for r in walking.reports[before:-1]]
    assert set(states) == {State.WALKING}
    assert walking.reports[-1].reason == "4 estimates in a row unusable, limit 3"


def test_the_robot_walks_on_without_imu(walking):
    walking.validity = Validity.IMU_MISSING
    assert walking.run(1.0).state is State.WALKING


def test_a_missing_imu_is_warned_of_until_it_is_back(walking):
    walking.validity = Validity.IMU_MISSING
    limit = SETTINGS.estimate.imu_silence
    assert walking.run(limit).warnings == ()
    assert walking.run(2 * CYCLE).warnings[0].startswith("no usable IMU for 0.5")
    walking.validity = Validity.VALID
    assert walking.run(2 * CYCLE).warnings == ()


def swing(bench, seconds, sway):
    """Commands that swing by 1 rad while the torso sways by an amount (m), as of a walk."""
    for _ in range(round(seconds / CYCLE)):
        phase = 2 * np.pi * bench.now * 1e-9 / 0.6
        bench.command = np.full(4, 1.0 + 0.5 * np.sin(phase))
        bench.state[3:6] += sway * np.random.default_rng(bench.now).choice(
            [-0.5, 0.5], 3
        )
        bench.run(CYCLE)
        bench.state[3:6] = [0.0, 0.0, HEIGHT]


@pytest.mark.parametrize(("sway", "ends"), [(0.001, State.HOLD), (0.02, State.WALKING)])
def test_commands_that_swing_without_motion_end_in_hold_until_the_next_ready(
    walking, sway, ends
):
    swing(walking, SETTINGS.motion.window - 1.0, sway)  # it walks for 1 s already
    assert walking.reports[-1].state is State.WALKING
    swing(walking, 1.0, sway)
    assert walking.reports[-1].state is ends
    if ends is State.HOLD:
        assert walking.reports[-1].reason.startswith("no motion seen: torso ")
        refused = walking.supervisor.request(walking.now, Request.WALK)
        assert refused.startswith("WALK refused in HOLD: it ends")
        assert (
            walking.time_until(State.RELAX, TIMING.hold_max + 1.0)
            > TIMING.hold_max - 1.1
        )


def test_missing_estimates_end_in_hold(walking):
    walking.silent.add("estimate")
    limit = SETTINGS.estimate.silence
    assert limit - CYCLE <= walking.time_until(State.HOLD, 1.0) <= limit + STEP


def test_the_robot_walks_on_while_the_mpc_falls_back(walking):
    walking.status, walking.fallback_cycles = (
        Status.NOT_SOLVED,
        read_mpc().fallback.cycles,
    )
    assert walking.run(1.0).state is State.WALKING


def test_the_end_of_a_recorder_is_said_while_the_robot_walks_on(walking):
    needed, gone = (
        {"mpc_controller"},
        "node recorder has ended; the robot goes on without it",
    )
    for names, said in (
        (needed, ()),
        (needed | {"recorder"}, ()),
        (needed, (gone,)),
        (set(), (gone,)),
        ({"recorder"}, ()),
    ):
        walking.supervisor.receive_nodes(names)
        report = walking.tick()
        assert report.state is State.WALKING
        assert report.warnings == said


def test_hold_lasts_while_its_reason_recurs(walking):
    good = walking.command
    for k in range(20):
        walking.command = good if k % 2 else np.full(4, math.nan)
        walking.run(CYCLE)
    assert {r.state for r in walking.reports[-50:]} == {State.HOLD}


def test_a_goal_that_the_rate_limit_holds_back_is_warned_of(walking):
    walking.health = {"slewed": np.array([True, True, False, False])}
    assert any("command slewed" in warning for warning in walking.tick().warnings)


def test_a_servo_whose_readings_are_not_finite_counts_as_silent(walking):
    walking.torque = np.array([0.8, math.nan, 0.8, 0.8])
    assert walking.time_until(State.RELAX, 1.0) <= TIMING.servo_silent + 2 * STEP
    assert "servo FR silent" in walking.reports[-1].reason


@pytest.mark.parametrize("silence", [math.nan, math.inf, -3.0])
def test_a_servo_whose_silence_is_invalid_counts_as_silent_since_the_start(
    walking, silence
):
    walking.health = dict(silence=np.array([0.0, silence, 0.0, 0.0]))
    assert walking.time_until(State.RELAX, 1.0) <= 2 * STEP
    assert "servo FR silent since the start" in walking.reports[-1].reason


@pytest.mark.parametrize("action", [Action.RELAX, Action.OFF])
def test_a_relax_begun_by_the_servos_ends_in_fault_with_their_reason(walking, action):
    walking.health = dict(action=action, reason="servo RL (id 2): torque is off")
    assert walking.time_until(State.RELAX, 1.0) <= 2 * STEP
    assert walking.reports[-1].reason == "servos: servo RL (id 2): torque is off"
    assert ends_in_fault(walking)


def test_a_driver_that_does_not_switch_torque_on_ends_in_relax():
    bench = SupervisorBench()
    bench.health = dict(
        action=Action.OFF, reason="stopped", torque=np.zeros(4, dtype=bool)
    )
    bench.bring_to(State.READY)
    refused = bench.supervisor.request(bench.now, Request.STAND)
    assert refused == "STAND refused in READY: servo FL without torque"
    assert bench.time_until(State.RELAX, 2.0) == pytest.approx(
        TIMING.torque_change, abs=3 * STEP
    )
    assert bench.reports[-1].reason == "servos: stopped"


@pytest.mark.parametrize(
    ("roll", "pitch"), [(0.51, 0.0), (-0.51, 0.0), (0.0, 0.51), (0.0, -0.51)]
)
def test_a_tilt_beyond_half_a_radian_ends_in_relax(walking, roll, pitch):
    walking.state = state(roll, pitch)
    assert walking.time_until(State.RELAX, 1.0) <= CYCLE + STEP
    assert "limit 0.5 rad" in walking.reports[-1].reason
    assert ends_in_fault(walking)


def test_the_tilt_of_an_unusable_estimate_counts(walking):
    walking.state, walking.validity = state(roll=0.6), Validity.ODOMETRY_REJECTED
    assert walking.time_until(State.RELAX, 1.0) <= CYCLE + STEP


@pytest.mark.parametrize("jump", [-3600.0, -0.6, 0.6, 1e6])
def test_a_clock_jump_ends_in_hold_and_then_in_walking(walking, jump):
    walking.now += round(jump * 1e9)
    assert walking.tick().state is State.HOLD
    assert "clock jumped by" in walking.reports[-1].reason
    assert walking.time_until(State.WALKING, 1.0) <= TIMING.recovery + CYCLE + STEP


@pytest.mark.parametrize("source", ["command", "estimate", "joints"])
def test_inputs_stamped_by_another_clock_are_rejected(walking, source):
    walking.silent.add(source if source != "joints" else "servos")
    wall = 1_700_000_000_000_000_000
    walking.tick()
    s, now = walking.supervisor, walking.now
    if source == "command":
        assert "limit 0.5 s" in s.receive_command(now, wall, np.full(4, 1.9))
    elif source == "estimate":
        s.receive_estimate(
            now, Estimate(wall, state(roll=1.0), np.eye(12), Validity.VALID)
        )
    else:
        s.receive_joints(now, wall, walking.angle, load(walking.angle))
        s.receive_health(now, wall, health(hardware_error=np.full(4, 32)))
    report = walking.tick()
    assert report.state is State.WALKING
    assert (walking.goals.angle == 1.1).all()
    assert any(source in w and "limit 0.5 s" in w for w in report.warnings)
    assert walking.time_until(State.WALKING, 0.6) < 1.0
    walking.run(0.6)
    assert (
        walking.supervisor.state is not State.WALKING
    )  # rejected inputs count as missing


def test_a_fault_of_a_stamp_is_reported_once_also_if_the_next_stamp_is_right(walking):
    """Joint states come every 10 ms, a report only every 20 ms."""
    s = walking.supervisor
    s.receive_joints(walking.now, 1, walking.angle, load(walking.angle))
    assert any("joints stamped -" in warning for warning in walking.tick().warnings)
    assert walking.tick().warnings == ()


def test_a_command_older_than_the_last_is_rejected(walking):
    first = walking.now - 50_000_000
    assert "not newer" in walking.supervisor.receive_command(
        walking.now, first, np.full(4, 1.9)
    )
    walking.tick()
    assert (walking.goals.angle == 1.1).all()


@pytest.mark.parametrize("node", SETTINGS.nodes)
def test_a_silent_node_ends_in_hold(walking, node):
    walking.silent.add(node)
    assert walking.time_until(State.HOLD, 1.0) <= TIMING.heartbeat + 2 * STEP
    assert walking.reports[-1].reason.startswith(f"node {node} silent")


def test_tendons_are_watched_only_once_the_legs_follow_the_gait_again(walking):
    walking.silent.add("command")
    assert walking.time_until(State.HOLD, 1.0) < 1.0
    walking.silent.clear()
    assert walking.time_until(State.WALKING, 1.0) < 1.0
    walking.torque = np.array([0.8, 0.8, 0.0, 0.8])
    took = walking.time_until(State.HOLD, 5.0)
    least = SETTINGS.gate.resume_time + SETTINGS.tendon.window_min
    assert least <= took < least + 1.0
    assert walking.reports[-1].reason.startswith("slack or broken tendon RL")


def test_steady_time_does_not_go_back_with_the_clock():
    clock = SteadyClock(0.5)
    times = [clock.advance(now) for now in (0, 100, 50, 60, 10**10, 10**10 + 5, 0, 7)]
    assert times == [0, 100, 100, 110, 110, 115, 115, 122]
    assert clock.jumped.startswith("clock jumped by -10 s")


def test_a_fault_during_a_requested_relax_ends_in_fault(walking):
    walking.request(Request.RELAX)
    walking.tick()
    walking.health = dict(hardware_error=np.array([0x20, 0, 0, 0]))
    walking.tick()
    walking.health = dict()
    assert walking.time_until(State.FAULT, 3.0) <= RELAX_TIME + 2 * STEP
