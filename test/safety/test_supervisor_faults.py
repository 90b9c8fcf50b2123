"""Supervisor: every fault in its time limit, and what leads on from it.

No sequence of random inputs makes supervisor and watchdog break a rule of safety.
"""

import math
from functools import partial

import numpy as np
import pytest
from supervisor_bench import (
    CYCLE,
    OVERLOAD,
    ROBOT,
    STEP,
    STRIDE,
    WAYS,
    SupervisorBench,
    bench_in,
    load,
    state,
)

from slot_core.control.policy import Status
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.safety.conditions import Conditions
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Action, Condition, Request, State
from slot_core.safety.supervisor import SteadyClock

SETTINGS = read_supervisor()
TIMING = SETTINGS.timing
RELAX_TIME = SETTINGS.gate.relax_time


@pytest.fixture
def walking():
    return bench_in(State.WALKING)


UNUSABLE = "4 estimates in a row unusable, limit 3"
TORQUE_LOST = "servo RL (id 2): torque is off"
SILENCE = SETTINGS.estimate.silence
NAN = math.nan
REJECTED, AT_ONCE = (3 * CYCLE, 4 * CYCLE), (0.0, CYCLE)  # s
# Differences of the bench, the state that they end in, bounds of the time until then (s), reason.
FAULTS = [
    ({"validity": Validity.ODOMETRY_REJECTED}, "HOLD", REJECTED, UNUSABLE),
    (
        {"validity": Validity.INITIALISING, "message": "imu: in g?"},
        "HOLD",
        REJECTED,
        f"{UNUSABLE}: imu: in g?",
    ),
    ({"state": np.full(12, NAN)}, "HOLD", REJECTED, UNUSABLE),
    (
        {"silent": {"estimate"}},
        "HOLD",
        (SILENCE - CYCLE, SILENCE),
        "no estimate for",
    ),
    (
        {"state": state(0.51, 0.0)},
        "RELAX",
        AT_ONCE,
        "roll +0.510 rad, limit 0.5 rad",
    ),
    ({"state": state(-0.51, 0.0)}, "RELAX", AT_ONCE, "roll -0.510 rad"),
    ({"state": state(0.0, 0.51)}, "RELAX", AT_ONCE, "pitch +0.510 rad"),
    ({"state": state(0.0, -0.51)}, "RELAX", AT_ONCE, "pitch -0.510 rad"),
    (
        {"state": state(0.6), "validity": Validity.ODOMETRY_REJECTED},
        "RELAX",
        AT_ONCE,
        "roll +0.600 rad",
    ),
    (
        {"torque": np.array([0.8, NAN, 0.8, 0.8])},
        "RELAX",
        (0.0, TIMING.servo_silent),
        "servo FR silent",
    ),
    (
        {"silent": {"mpc"}},
        "HOLD",
        (TIMING.heartbeat - CYCLE, TIMING.heartbeat),
        "node mpc_controller silent",
    ),
    *(
        (
            {"health": {"silence": np.array([0.0, silence, 0.0, 0.0])}},
            "RELAX",
            (0.0, 0.0),
            "servo FR silent since the start",
        )
        for silence in (NAN, math.inf, -3.0)
    ),
    *(
        (
            {"health": {"action": action, "reason": TORQUE_LOST}},
            "RELAX",
            (0.0, 0.0),
            f"servos: {TORQUE_LOST}",
        )
        for action in (Action.RELAX, Action.OFF)
    ),
]


@pytest.mark.parametrize(("changes", "ends", "bounds", "reason"), FAULTS)
def test_a_fault_ends_in_its_state_within_its_time(
    walking, changes, ends, bounds, reason
):
    vars(walking).update(changes)
    before, goal = len(walking.reports), walking.goals.angle.max()
    took = walking.time_until(State[ends], 1.0)
    assert bounds[0] <= took <= bounds[1] + 2 * STEP
    assert {r.state for r in walking.reports[before:-1]} <= {State.WALKING}
    assert walking.reports[-1].reason.startswith(reason)
    if ends == "RELAX":  # slack, then a fault, in which torque stays off
        assert walking.time_until(State.FAULT, RELAX_TIME + 2 * STEP) < math.inf
        assert walking.goals.angle.max() < goal
        assert walking.run(2.0).state is State.FAULT
        assert not walking.goals.torque


@pytest.mark.parametrize(
    ("before", "requests", "resumed"),
    [(State.WALKING, [Request.STAND], False), (State.STANDING, [], True)],
)
def test_a_hold_of_a_stand_or_with_stand_requested_ends_in_standing(
    before, requests, resumed
):
    bench = bench_in(before)
    bench.silent.add("command")
    bench.time_until(State.HOLD, 1.0)
    bench.request(*requests)
    bench.silent.clear()
    assert bench.time_until(State.STANDING, 1.0) < 1.0
    assert bench.reports[-1].resumed == resumed


def test_before_the_first_estimate_its_topics_are_named():
    reason = Conditions(SETTINGS).conditions(0)[Condition.ESTIMATE_LOST]
    assert "waits for /odom and /imu" in reason


def hold_once(bench):
    """Let the robot hold and recover; returns the state after that."""
    bench.status = Status.STOPPED
    bench.run(CYCLE)
    bench.status = Status.SOLVED
    return bench.run(TIMING.recovery + 2 * CYCLE).state


def test_one_hold_too_many_within_the_window_ends_in_a_fault_that_names_its_cause(
    walking,
):
    held = [hold_once(walking) for _ in range(TIMING.holds_max + 1)]
    assert held == [State.WALKING] * TIMING.holds_max + [State.RELAX]
    assert walking.reports[-1].reason == (
        "held 4 times in 20 s, limit 3, at last for: MPC stopped, 0 cycles"
        " without a solution; mend that, then reset"
    )
    assert walking.time_until(State.FAULT, RELAX_TIME + 2 * STEP) < math.inf
    for request in (Request.RESET, *WAYS[State.WALKING]):
        walking.request(request)
        walking.run(1.0)
    assert hold_once(walking) is State.WALKING  # they count from READY on


def test_holds_further_apart_than_the_window_do_not_count_together(walking):
    for _ in range(2 * TIMING.holds_max):
        assert hold_once(walking) is State.WALKING
        walking.run(TIMING.holds_window / TIMING.holds_max)


def test_a_missing_imu_is_warned_of_until_it_is_back_and_the_robot_walks_on(
    walking,
):
    walking.validity = Validity.IMU_MISSING
    assert walking.run(SETTINGS.estimate.imu_silence).warnings == ()
    report = walking.run(2 * CYCLE)
    assert report.warnings[0].startswith("no usable IMU for 0.5")
    assert report.state is State.WALKING
    walking.validity = Validity.VALID
    assert walking.run(2 * CYCLE).warnings == ()


def swing(bench):
    """Command a stride for the window in which motion has to be seen."""
    for _ in range(round(SETTINGS.motion.window / CYCLE)):
        phase = 2 * np.pi * bench.now * 1e-9 / STRIDE
        bench.command = np.full(4, 1.0 + 0.5 * np.sin(phase))
        bench.run(CYCLE)


def test_commands_that_swing_without_motion_end_in_hold_until_the_next_ready(
    walking,
):
    swing(walking)
    assert walking.reports[-1].state is State.HOLD
    assert walking.reports[-1].reason.startswith("no motion seen: torso ")
    assert walking.supervisor.request(walking.now, Request.WALK).startswith(
        "WALK refused in HOLD: it ends"
    )
    assert walking.time_until(State.RELAX, TIMING.hold_max + 1.0) < math.inf


PLACE = "no watch of motion and tendons: the place is not known"
TILT = "no watch of the tilt: it is not known"
HANGING = "no watch of the tilt: the robot hangs on a bench"
# setting, standard deviations of tilt and place, what is said
UNWATCHED = [
    (False, 0.01, 10.0, (PLACE,)),
    (False, 0.09, 10.0, (PLACE, TILT)),
    (True, 0.01, 10.0, (PLACE, HANGING)),
]


@pytest.mark.parametrize(("hangs", "tilt", "place", "said"), UNWATCHED)
def test_what_is_not_known_is_not_watched_and_that_is_said(
    hangs, tilt, place, said
):
    deviation = np.repeat([tilt, place], [3, 9])
    bench = bench_in(
        State.WALKING, deviation=deviation, settings={"bench": hangs}
    )
    swing(bench)
    assert bench.reports[-1].state is State.WALKING
    assert bench.reports[-1].warnings == said
    bench.state = state(0.8)
    assert (bench.run(0.2).state is State.WALKING) == (len(said) == 2)
    bench.state = state()
    bench.health = OVERLOAD
    report = bench.run(0.1)
    error = "servo FL: overload error, register 70 = 0x20, limit 0"
    assert (report.state, error in report.warnings) == (State.RELAX, True)


@pytest.mark.parametrize(
    ("moved", "said"),
    [
        ((0.0, 0.047), ""),
        ((0.0, 0.044), "walks 44 of 50 mm/s, least 46: floor, slope, load"),
        ((0.036, 0.05), "slides 36 mm/s right, limit 15: floor"),
        ((0.0, -0.005), "walks -5 of 50 mm/s, least 46: floor, slope, load"),
    ],
)
def test_a_walk_that_slides_or_gets_on_too_slowly_is_said_while_it_goes_on(
    walking, moved, said
):
    """The heading is +y; when it walks as commanded the line goes."""
    walking.velocity = np.array([0.05, 0.0, 0.0])
    turned = partial(state, yaw=math.pi / 2)
    walking.state = turned(velocity=moved)
    limits = SETTINGS.motion
    report = walking.run(limits.slip_window + limits.slow_time + 2.0)
    assert report.state is State.WALKING
    assert [w[: len(said)] for w in report.warnings] == [said] * bool(said)
    walking.state = turned(velocity=(0.0, 0.05))
    assert walking.run(limits.slip_window + 1.0).warnings == ()


@pytest.mark.parametrize(
    ("aside", "torque", "said"),
    [
        (-0.08, None, "slides 7"),
        (-0.15, np.array([0.0, 1.0, 1.0, 1.0]), "slides 1"),  # a dragged leg
    ],
)
def test_a_walk_that_slides_faster_than_it_walks_ends_in_hold(
    walking, aside, torque, said
):
    walking.velocity = np.array([0.05, 0.0, 0.0])
    walking.state = state(velocity=(0.05, aside))
    walking.run(1.0)
    walking.torque = torque
    took = walking.time_until(State.HOLD, 10.0)
    assert took < SETTINGS.motion.slip_window
    assert walking.reports[-1].reason.startswith(said)
    assert walking.time_until(State.RELAX, TIMING.hold_max + 1.0) < math.inf


def test_the_end_of_a_recorder_is_said_while_the_robot_walks_on(walking):
    gone = "node recorder has ended; the robot goes on without it"
    needed = {"mpc_controller"}
    for names, said in (
        (needed, ()),
        (needed | {"recorder"}, ()),
        (needed, (gone,)),
        (set(), (gone,)),
        ({"recorder"}, ()),
    ):
        walking.supervisor.receive_nodes(names)
        report = walking.tick()
        assert (report.state, report.warnings) == (State.WALKING, said)


def test_hold_lasts_while_its_reason_recurs_within_the_time_of_recovery(
    walking,
):
    good = walking.command
    for _ in range(10):
        walking.command = np.full(4, math.nan)
        walking.run(CYCLE)
        walking.command = good
        walking.run(TIMING.recovery - CYCLE)
    assert {r.state for r in walking.reports[-150:]} == {State.HOLD}
    assert walking.run(2 * CYCLE).state is State.WALKING


def test_a_goal_that_the_rate_limit_holds_back_is_warned_of(walking):
    walking.health = {"slewed": np.array([True, True, False, False])}
    assert any(
        "command slewed" in warning for warning in walking.tick().warnings
    )


def test_a_driver_that_does_not_switch_torque_on_ends_in_relax():
    off = {
        "action": Action.OFF,
        "reason": "stopped",
        "torque": np.zeros(4, dtype=bool),
    }
    bench = bench_in(State.IDLE, health=off)
    bench.request(Request.READY)
    refused = bench.supervisor.request(bench.now, Request.STAND)
    assert refused == "STAND refused in READY: servo FL without torque"
    took = bench.time_until(State.RELAX, 2.0)
    assert took == pytest.approx(TIMING.torque_change, abs=3 * STEP)
    assert bench.reports[-1].reason == "servos: stopped"


@pytest.mark.parametrize("jump", [-3600.0, -0.6, 0.6, 1e6])
def test_after_a_clock_jump_and_a_hold_the_robot_walks_and_is_watched(
    walking, jump
):
    """Tendons are watched once the legs follow the gait again."""
    walking.now += round(jump * 1e9)
    assert walking.tick().state is State.HOLD
    said = f"clock jumped by {jump + STEP:+.3g} s, limit 0.5"
    assert walking.reports[-1].reason == said
    assert (
        walking.time_until(State.WALKING, 1.0) <= TIMING.recovery + CYCLE + STEP
    )
    walking.torque = np.array([0.8, 0.8, 0.0, 0.8])
    took = walking.time_until(State.HOLD, 5.0)
    least = SETTINGS.gate.resume_time + SETTINGS.tendon.window_min
    assert least <= took < least + 1.0
    assert walking.reports[-1].reason.startswith("slack or broken tendon RL")


def test_slack_is_unknown_while_commands_are_late(walking):
    walking.run(1.0)
    assert np.isfinite(walking.reports[-1].slack).all()
    walking.silent.add("command")
    report = walking.run(SETTINGS.tendon.age_max + STEP)
    assert report.state is State.WALKING
    assert np.isnan(report.slack).all()


@pytest.mark.parametrize("source", ["command", "estimate", "joints"])
def test_inputs_stamped_by_another_clock_are_rejected_and_reported_once(
    walking, source
):
    """Also if the next stamp is right."""
    s, now, wall = walking.supervisor, walking.now, 1_700_000_000_000_000_000
    if source == "command":
        assert "limit 0.5 s" in s.receive_command(now, wall, np.full(4, 1.9))
        older = now - 50_000_000
        assert "not newer" in s.receive_command(now, older, np.full(4, 1.9))
    elif source == "estimate":
        s.receive_estimate(
            now,
            Estimate(wall, state(roll=1.0), np.zeros((12, 12)), Validity.VALID),
        )
    else:
        s.receive_joints(now, wall, walking.angle, np.zeros(4))
        s.receive_health(now, wall, walking.servo_health(**OVERLOAD))
    report = walking.tick()
    assert report.state is State.WALKING
    assert any(source in w and "limit 0.5 s" in w for w in report.warnings)
    assert walking.run(CYCLE).warnings == ()


def test_steady_time_does_not_go_back_with_the_clock():
    clock = SteadyClock(0.5)
    times = [
        clock.advance(now) for now in (0, 100, 50, 60, 10**10, 10**10 + 5, 0, 7)
    ]
    assert times == [0, 100, 100, 110, 110, 115, 115, 122]


def test_a_fault_during_a_requested_relax_ends_in_fault(walking):
    walking.request(Request.RELAX)
    walking.health = OVERLOAD
    walking.tick()
    walking.health = {}
    assert walking.time_until(State.FAULT, 3.0) <= RELAX_TIME + 2 * STEP


RELAX_MAX = SETTINGS.gate.relax_time + SETTINGS.timing.torque_change + 0.02  # s
OFF = (State.IDLE, State.ESTOP, State.FAULT)


def random_input(rng, bench, supervisor, steady):
    """One random input, valid or not; returns the request to make, or None."""
    now = bench.now
    wrong = rng.choice(
        [0.0, 1.0, math.nan, math.inf, -1e9], p=[0.9, 0.04, 0.03, 0.02, 0.01]
    )
    stamp = (
        now
        - int(rng.integers(0, 40_000_000))
        + int(rng.choice([0, 10**12], p=[0.99, 0.01]))
    )
    kind = rng.integers(8)
    if kind <= 1:
        near = np.clip(bench.angle + rng.normal(0, 0.02, 4), 0, 2.0)
        angle = (
            near if rng.random() < 0.95 else rng.uniform(0, 2.0, 4)
        ) + wrong
        if not supervisor.receive_command(now, stamp, angle):
            bench.watchdog.offer(steady, angle)
    elif kind == 2:
        tilt = state(*rng.normal(0, 0.13, 2))
        valid = rng.choice(
            list(Validity), p=[0.85, 0.03, 0.06, 0.02, 0.02, 0.02]
        )
        supervisor.receive_estimate(
            now,
            Estimate(stamp, tilt + wrong, np.zeros((12, 12)), Validity(valid)),
        )
    elif kind == 3:
        angle = np.clip(bench.angle + rng.normal(0, 0.01, 4), 0, 2.0)
        torque = load(angle)
        angle[rng.integers(4)] += wrong
        supervisor.receive_joints(now, now, angle, torque)
        bits = rng.choice([0, 0x20], size=4, p=[0.9995, 0.0005])
        supervisor.receive_health(
            now, now, bench.servo_health(hardware_error=bits)
        )
    elif kind == 4:
        supervisor.receive_mpc(
            now,
            int(rng.choice([0, 1, 4], p=[0.9, 0.09, 0.01])),
            0,
            0.6,
            rng.normal(0, 0.05, 3),
        )
    elif kind == 5:
        supervisor.receive_estop(
            now, str(rng.integers(2)), bool(rng.random() < 0.002)
        )
    elif kind == 6:
        return Request(
            rng.choice(
                [*Request, *[Request.READY, Request.STAND, Request.WALK] * 6]
            )
        )
    return None


def test_no_sequence_of_events_violates_the_safety_rules():
    """10,000 random events: range, torque, latched states and the end of RELAX."""
    rng, bench = np.random.default_rng(11), SupervisorBench()
    supervisor, limit = bench.supervisor, ROBOT.tendon.angle_max
    before, relaxing, visited, steady = State.IDLE, 0.0, set(), 0
    for _ in range(10_000):
        jump = int(
            rng.choice([0, -(10**10), 10**10], p=[0.9996, 0.0002, 0.0002])
        )
        tick = int(rng.integers(0, 6_000_000))
        bench.now += tick + jump
        steady += tick
        request = random_input(rng, bench, supervisor, steady)
        granted = (
            request is not None and supervisor.request(bench.now, request) == ""
        )
        middle = supervisor.state
        report = supervisor.step(bench.now)
        bench.step_servos(steady, report)
        # 1: goals are finite and within the range
        assert all(
            0.0 <= angle <= limit for angle in bench.goals.angle.tolist()
        )
        # 2: torque only where the state allows it
        assert not (report.state in OFF and bench.goals.torque)
        # 3: latched states are left only by a granted reset
        for old, new in ((before, middle), (middle, report.state)):
            if old in {State.ESTOP, State.FAULT} and new not in {
                old,
                State.ESTOP,
            }:
                assert (granted, request, new) == (
                    True,
                    Request.RESET,
                    State.IDLE,
                )
        # 4: RELAX ends
        relaxing = (
            relaxing + tick * 1e-9
            if State.RELAX is before is report.state
            else 0.0
        )
        assert relaxing <= RELAX_MAX
        before = report.state
        visited.add(before)
    assert visited == set(State)
