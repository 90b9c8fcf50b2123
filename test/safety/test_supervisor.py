"""Supervisor: every fault in its time limit; only a reset leads out of ESTOP and FAULT."""

import itertools
import math

import numpy as np
import pytest
from supervised import ROBOT, START, TICK, Bench, health, load, state

from slot_core.control.policy import Status
from slot_core.estimation.estimate import Estimate, Validity
from slot_core.estimation.state_estimator import StateEstimator, read_estimator
from slot_core.mpc.settings import read_mpc
from slot_core.safety import states as table
from slot_core.safety.command_gate import Action
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Condition, State, next_state
from slot_core.safety.supervisor import Request, SteadyClock, Supervisor

SETTINGS = read_supervisor()
TIMING = SETTINGS.timing
STEP = TICK * 1e-9  # s
CYCLE = 3 * STEP  # s, between two estimates, commands and statuses of the MPC on the bench
RELAX_TIME = SETTINGS.gate.relax_time
OFF = (State.IDLE, State.ESTOP, State.FAULT)


@pytest.fixture
def walking():
    bench = Bench()
    bench.bring_to(State.WALKING)
    return bench


def ends_in_fault(bench):
    """Whether RELAX slackens the tendons and ends in FAULT, where torque stays off."""
    goal = bench.reports[-1].command.angle.max()
    took = bench.time_until(State.FAULT, RELAX_TIME + 2 * STEP)
    end = bench.reports[-1].command.angle.max()
    return (
        took < math.inf
        and end < goal
        and bench.run(2.0).state is State.FAULT
        and not any(r.command.torque for r in bench.reports[-200:])
    )


# The table


def test_the_table_covers_every_state_and_condition():
    assert list(table.TRANSITIONS) == list(Condition)  # in the order of urgency
    for state_, condition in itertools.product(State, Condition):
        assert isinstance(next_state(state_, condition), State)
    assert set(table.ACTIONS) == set(State)


@pytest.mark.parametrize("latched", [State.ESTOP, State.FAULT])
def test_only_a_reset_leads_out_of_estop_and_fault(latched):
    exits = {c: next_state(latched, c) for c in Condition if next_state(latched, c) is not latched}
    assert exits.pop(Condition.RESET_REQUESTED) is State.IDLE
    assert set(exits.values()) <= {State.ESTOP}  # the e-stop has precedence over a fault


def test_dangerous_conditions_precede_requests():
    order = list(Condition)
    requests = [c for c in Condition if c.name.endswith("_REQUESTED")]
    dangerous = [Condition.ESTOP_PRESSED, Condition.ESTOP_LOST, *table.REASONS_TO_RELAX]
    assert max(map(order.index, dangerous)) < min(map(order.index, requests))


def test_relax_leads_only_to_states_without_torque():
    for condition in Condition:
        assert next_state(State.RELAX, condition) in {State.RELAX, *OFF}


def test_commands_pass_only_in_standing_and_walking():
    passing = {s for s, action in table.ACTIONS.items() if action is Action.PASS}
    assert passing == {State.STANDING, State.WALKING}
    assert {s for s, action in table.ACTIONS.items() if action is Action.OFF} == set(OFF)


def test_the_diagram_shows_the_table():
    drawn = set()
    groups = {
        "a reason to hold": table.REASONS_TO_HOLD,
        "a fault": table.FAULTS,
    }
    for line in table.__doc__.splitlines():
        if "-->" in line and "[*]" not in line:
            way, _, labels = line.partition(":")
            before, after = (State[name.strip()] for name in way.split("-->"))
            for label in labels.split(","):
                named = groups.get(label.strip()) or {Condition[label.strip()]}
                drawn |= {(before, c, after) for c in named}
    estop = {Condition.ESTOP_PRESSED, Condition.ESTOP_LOST}  # in a note
    real = {
        (s, c, next_state(s, c))
        for s, c in itertools.product(State, Condition)
        if next_state(s, c) is not s and c not in estop
    }
    assert drawn == real
    for name in ("FAULTS", "REASONS_TO_HOLD"):
        for condition in getattr(table, name):
            assert condition.name in table.__doc__


# From IDLE to WALKING


def test_the_robot_goes_from_idle_to_walking_on_request():
    bench = Bench()
    assert not bench.run(0.3).command.torque
    bench.request(Request.READY)
    assert bench.tick().command.action is Action.HOLD
    bench.run(0.02)
    bench.request(Request.STAND)
    assert bench.run(1.0).state is State.STANDING
    bench.request(Request.WALK)
    report = bench.run(1.0)
    assert report.state is State.WALKING
    assert report.reason == "walk requested by the operator"
    assert report.warnings == ()
    bench.command = np.full(4, 1.5)
    assert (bench.run(0.05).command.angle == 1.5).all()


def test_torque_comes_on_without_motion_far_from_the_command():
    bench = Bench()
    bench.angle, bench.command = np.array([0.2, 0.6, 1.3, 2.0]), np.full(4, 1.0)
    before = bench.angle
    bench.run(0.3)
    bench.request(Request.READY)
    bench.run(1.0)
    assert (bench.reports[-1].command.angle == before).all()
    assert bench.reports[-1].command.torque
    bench.request(Request.STAND)
    first = bench.tick().command.angle
    assert np.abs(first - before).max() <= SETTINGS.gate.approach_rate * SETTINGS.gate.burst + 1e-12


@pytest.mark.parametrize(
    ("wanted", "request_", "text"),
    [
        (State.IDLE, Request.STAND, "STAND changes nothing in IDLE"),
        (State.IDLE, Request.WALK, "WALK changes nothing in IDLE"),
        (State.READY, Request.WALK, "WALK changes nothing in READY"),
        (State.ESTOP, Request.READY, "READY changes nothing in ESTOP"),
        (State.FAULT, Request.READY, "READY changes nothing in FAULT"),
        (State.FAULT, Request.WALK, "WALK changes nothing in FAULT"),
        (State.WALKING, Request.RESET, "RESET changes nothing in WALKING"),
    ],
)
def test_a_request_that_the_state_does_not_allow_is_refused(wanted, request_, text):
    bench = Bench()
    bench.bring_to(wanted)
    assert bench.supervisor.request(bench.now, request_) == text
    assert bench.tick().state is wanted


@pytest.mark.parametrize(
    ("cause", "text"),
    [
        (lambda b: b.silent.add("estop"), "e-stop source silent"),
        (lambda b: b.silent.add("servos"), "servo FL silent"),
        (lambda b: setattr(b, "state", state(pitch=-0.6)), "pitch -0.600 rad, limit 0.5 rad"),
        (lambda b: setattr(b, "angle", np.array([1, 1, -0.3, 1])), "servo RL at -0.3 rad, limits"),
    ],
    ids=["estop", "servos", "tilt", "zero"],
)
def test_ready_is_refused_during_a_fault(cause, text):
    bench = Bench(**{"timing.estop": 0.3, "timing.servo_silent": 0.3})
    cause(bench)
    bench.run(0.5)
    refusal = bench.supervisor.request(bench.now, Request.READY)
    assert refusal.startswith("READY refused in IDLE: ")
    assert text in refusal
    assert bench.tick().state is State.IDLE


@pytest.mark.parametrize("missing", ["command", "estimate", *SETTINGS.nodes])
def test_stand_is_refused_while_an_input_is_missing(missing):
    bench = Bench()
    bench.bring_to(State.READY)
    bench.silent.add(missing)
    bench.run(0.6)
    assert bench.supervisor.request(bench.now, Request.STAND).startswith("STAND refused in READY")
    assert bench.tick().state is State.READY


def test_walk_is_refused_far_from_the_command():
    bench = Bench()
    bench.bring_to(State.STANDING)
    bench.command = np.full(4, 1.9)
    bench.run(0.05)
    assert "from their command, limit 0.1 rad" in bench.supervisor.request(bench.now, Request.WALK)


def test_the_commands_are_followed_from_when_the_legs_have_reached_them():
    bench = Bench()
    bench.command = np.full(4, 1.9)
    assert not bench.bring_to(State.STANDING).followed
    while not bench.reports[-1].followed:
        assert np.abs(bench.angle - 1.9).max() > SETTINGS.arrived - 2.0 * STEP
        bench.tick()
    bench.command = np.full(4, 1.2)  # from then on any command is
    assert bench.run(0.5).followed
    bench.silent.add("command")
    bench.time_until(State.HOLD, 1.0)
    assert not bench.reports[-1].followed
    bench.silent.clear()
    bench.time_until(State.STANDING, 1.0)
    assert bench.run(0.1).followed


def test_goals_move_slowly_until_they_are_reached_and_right_afterwards():
    bench = Bench()
    bench.bring_to(State.STANDING)
    start = bench.angle.copy()
    bench.command = np.full(4, 1.6)
    bench.run(0.1)
    assert (bench.angle < start + SETTINGS.gate.approach_rate * 0.15).all()
    while not bench.reports[-1].followed:
        bench.tick()
    bench.command = np.full(4, 2.0)
    bench.run(0.05)
    # a tenth of resume_time: the rate has grown by a tenth of its range
    gate = SETTINGS.gate
    assert 1.6 < bench.angle.max() < 1.6 + 0.1 * gate.rate_max * (0.05 + gate.burst)


def test_walk_is_refused_while_the_goals_of_the_servos_are_unknown():
    bench = Bench()
    bench.bring_to(State.STANDING)
    bench.run(1.0)
    bench.health = {"goal": np.full(4, math.nan)}
    bench.run(0.1)
    reason = bench.supervisor.request(bench.now, Request.WALK)
    assert "the legs are nan rad from their command" in reason


def test_a_broken_tendon_is_found_after_the_clock_was_set_back(walking):
    """Readings with stamps of before count as new."""
    walking.now -= 3_600_000_000_000
    walking.tick()
    assert walking.supervisor.state is State.HOLD
    assert walking.time_until(State.WALKING, 1.0) < 1.0
    walking.run(2.0)
    walking.torque = np.zeros(4)
    assert walking.time_until(State.HOLD, 3.0) < 3.0
    assert "slack or broken tendon" in walking.reports[-1].reason


# Faults


def test_missing_commands_end_in_hold_at_100_ms_and_relax_at_500_ms(walking):
    walking.silent.add("command")
    hold = walking.time_until(State.HOLD, 1.0)
    held = walking.reports[-1].command
    assert TIMING.command_hold - CYCLE <= hold <= TIMING.command_hold + STEP
    assert "no command for" in walking.reports[-1].reason
    assert any("limit 0.1 s" in warning for warning in walking.reports[-1].warnings)
    relax = hold + walking.time_until(State.RELAX, 1.0)
    assert (walking.reports[-2].command.angle == held.angle).all()  # the last angle was kept
    assert TIMING.command_lost - CYCLE <= relax <= TIMING.command_lost + STEP
    assert ends_in_fault(walking)


def test_the_robot_walks_again_when_commands_return_in_time(walking):
    walking.silent.add("command")
    walking.time_until(State.HOLD, 1.0)
    walking.silent.clear()
    assert walking.time_until(State.WALKING, 1.0) <= TIMING.recovery + CYCLE + STEP
    assert "no reason to hold for 0.2 s" in walking.reports[-1].reason
    assert walking.reports[-1].resumed  # with the gait that was requested last


def test_stand_requested_in_hold_ends_in_standing(walking):
    walking.silent.add("command")
    walking.time_until(State.HOLD, 1.0)
    walking.request(Request.STAND)
    walking.silent.clear()
    assert walking.time_until(State.STANDING, 1.0) < 1.0
    assert not walking.reports[-1].resumed  # it walked before


def test_a_robot_held_while_it_stands_resumes_standing():
    bench = Bench()
    bench.bring_to(State.STANDING)
    assert not bench.tick().resumed
    bench.silent.add("command")
    bench.time_until(State.HOLD, 1.0)
    bench.silent.clear()
    assert bench.time_until(State.STANDING, 1.0) < 1.0
    assert bench.reports[-1].resumed


def test_a_hold_longer_than_its_limit_ends_in_relax(walking):
    walking.status = Status.STOPPED
    walking.time_until(State.HOLD, 1.0)
    took = walking.time_until(State.RELAX, 10.0)
    assert took == pytest.approx(TIMING.hold_max, abs=2 * STEP)
    assert "limit 5 s, since: MPC stopped" in walking.reports[-1].reason
    assert ends_in_fault(walking)


@pytest.mark.parametrize("bad", [Validity.ODOMETRY_REJECTED, Validity.INITIALISING, "NaN"])
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


def test_missing_estimates_end_in_hold(walking):
    walking.silent.add("estimate")
    limit = SETTINGS.estimate.silence
    assert limit - CYCLE <= walking.time_until(State.HOLD, 1.0) <= limit + STEP


@pytest.mark.parametrize("error", ["jump", "NaN", "stale"])
def test_bad_odometry_is_bridged_for_three_cycles_and_then_ends_in_hold(error):
    """Odometry jumps by 10 cm, is NaN or stops, and passes the estimator that rejects it."""
    bench = Bench()
    estimator, imu = StateEstimator(read_estimator()), START
    bench.silent |= {"estimate", "command"}  # both come from the estimator below
    bad_from, states, seen = 60, {}, []
    gravity, nothing = np.array([0.0, 0.0, 9.81]), np.zeros(3)
    for cycle in range(1, 100):
        for _ in range(3):
            bench.tick()
        if cycle == 20:
            bench.request(Request.READY, Request.STAND)
        while imu < bench.now:
            imu += 5_000_000
            estimator.add_imu(imu, nothing, gravity)
        place, bad = np.array([0.0, 0.0, 0.04]), cycle > bad_from
        if bad and error != "stale":
            place[0] = 0.1 if error == "jump" else math.nan
        if not (bad and error == "stale"):
            estimator.add_odometry(bench.now, place, np.array([0, 0, 0, 1.0]), nothing, nothing)
        while (estimate := estimator.poll()) is not None:
            seen.append((cycle, estimate.validity, estimate.state[3]))
            bench.supervisor.receive_estimate(bench.now, estimate)
        bench.supervisor.receive_command(bench.now, bench.now, bench.command)  # the MPC continues
        states[cycle] = bench.supervisor.state
    # the estimator rejects five readings, starts anew, and its tenth at the new position is valid
    gate = read_estimator().gate
    trusted = bad_from + gate.max_rejections + gate.initial_readings - 1
    moved = [c for c, valid, x in seen if valid is Validity.VALID and abs(x) > 0.02]
    assert not moved or moved[0] >= trusted
    assert states[bad_from] is State.STANDING
    assert {states[bad_from + k] for k in (1, 2, 3)} == {State.STANDING}
    # at the first step after the fourth bad cycle; for stale odometry by its age, 0.132 s
    assert states[bad_from + (6 if error == "stale" else 5)] is State.HOLD


def test_an_mpc_that_has_stopped_ends_in_hold(walking):
    walking.status, walking.fallback_cycles = Status.STOPPED, 11
    assert walking.time_until(State.HOLD, 1.0) <= CYCLE + STEP
    assert "11 cycles" in walking.reports[-1].reason


def test_the_robot_walks_on_while_the_mpc_falls_back(walking):
    walking.status, walking.fallback_cycles = Status.NOT_SOLVED, read_mpc().fallback.cycles
    assert walking.run(1.0).state is State.WALKING


@pytest.mark.parametrize("value", [math.nan, -0.1, 2.5])
def test_a_command_with_a_bad_angle_is_rejected_as_a_whole_and_ends_in_hold(walking, value):
    walking.command = np.array([1.3, 1.3, value, 1.3])
    assert walking.time_until(State.HOLD, 1.0) <= CYCLE + STEP
    assert "command RL = " in walking.reports[-1].reason
    assert (walking.reports[-1].command.angle == 1.1).all()


def test_rejected_commands_count_as_missing(walking):
    walking.command = np.full(4, math.nan)
    took = walking.time_until(State.RELAX, 1.0)
    assert TIMING.command_lost - CYCLE <= took <= TIMING.command_lost + STEP


def test_hold_lasts_while_its_reason_recurs(walking):
    good = walking.command
    for k in range(20):
        walking.command = good if k % 2 else np.full(4, math.nan)
        walking.run(CYCLE)
    assert {r.state for r in walking.reports[-50:]} == {State.HOLD}


def test_a_step_larger_than_the_rate_limit_is_slewed_with_a_warning(walking):
    walking.command = np.array([0.0, 2.0, 1.1, 1.1])
    walking.silent.add("servos")  # on the bench the servos follow at once
    for _ in range(3):
        report = walking.tick()
        if report.command.slewed.any():
            break
    walking.command = np.array([2.0, 0.0, 1.1, 1.1])
    reports = [walking.tick() for _ in range(9)]
    first = next(k for k, r in enumerate(reports) if r.command.slewed.any())
    assert reports[first].command.slewed.tolist() == [True, True, False, False]
    walking.silent.clear()  # the servos report it
    walking.health = {"slewed": np.array([True, True, False, False])}
    assert any("command slewed" in warning for warning in walking.tick().warnings)
    assert reports[-1].state is State.WALKING


def test_one_silent_servo_relaxes_all_after_500_ms(walking):
    start = walking.now
    while walking.supervisor.state is State.WALKING:
        silence = np.array([0.0, 0.0, (walking.now + TICK - start) * 1e-9, 0.0])
        walking.health = dict(silence=silence)
        walking.tick()
    took = (walking.now - start) * 1e-9
    assert TIMING.servo_silent < took <= TIMING.servo_silent + 2 * STEP
    assert walking.reports[-1].state is State.RELAX
    assert "servo RL silent" in walking.reports[-1].reason
    assert ends_in_fault(walking)


def test_a_servo_whose_readings_are_not_finite_counts_as_silent(walking):
    walking.torque = np.array([0.8, math.nan, 0.8, 0.8])
    assert walking.time_until(State.RELAX, 1.0) <= TIMING.servo_silent + 2 * STEP
    assert "servo FR silent" in walking.reports[-1].reason


@pytest.mark.parametrize("silence", [math.nan, math.inf, -3.0])
def test_a_servo_whose_silence_is_invalid_counts_as_silent_since_the_start(walking, silence):
    walking.health = dict(silence=np.array([0.0, silence, 0.0, 0.0]))
    assert walking.time_until(State.RELAX, 1.0) <= 2 * STEP
    assert "servo FR silent since the start" in walking.reports[-1].reason


@pytest.mark.parametrize(
    ("errors", "text"),
    [
        ([0, 0x20, 0, 0], "servo FR: overload error"),
        ([0, 0, 0x04, 0], "servo RL: overheating error"),
        ([0x01, 0, 0, 0], "servo FL: input voltage error"),
    ],
    ids=["overload", "overheating", "low voltage"],
)
def test_a_hardware_error_relaxes_all_legs_until_a_reset(walking, errors, text):
    walking.health = dict(hardware_error=np.array(errors))
    assert walking.time_until(State.RELAX, 1.0) <= 2 * STEP
    assert text in walking.reports[-1].reason
    assert ends_in_fault(walking)
    refusal = walking.supervisor.request(walking.now, Request.RESET)
    assert refusal.startswith("RESET refused in FAULT")  # while the error lasts
    walking.health = dict()
    assert walking.run(1.0).state is State.FAULT
    walking.request(Request.RESET)
    assert walking.tick().state is State.IDLE


@pytest.mark.parametrize("action", [Action.RELAX, Action.OFF])
def test_a_relax_begun_by_the_servos_ends_in_fault_with_their_reason(walking, action):
    walking.health = dict(action=action, reason="servo RL (id 2): torque is off")
    assert walking.time_until(State.RELAX, 1.0) <= 2 * STEP
    assert walking.reports[-1].reason == "servos: servo RL (id 2): torque is off"
    assert ends_in_fault(walking)


def test_a_driver_that_does_not_switch_torque_on_ends_in_relax():
    bench = Bench()
    bench.health = dict(action=Action.OFF, reason="stopped", torque=np.zeros(4, dtype=bool))
    bench.bring_to(State.READY)
    refused = bench.supervisor.request(bench.now, Request.STAND)
    assert refused == "STAND refused in READY: servo FL without torque"
    assert bench.time_until(State.RELAX, 2.0) == pytest.approx(TIMING.torque_change, abs=3 * STEP)
    assert bench.reports[-1].reason == "servos: stopped"


@pytest.mark.parametrize("moving", [State.READY, State.STANDING, State.WALKING, State.RELAX])
def test_the_estop_switches_torque_off_at_once_until_a_reset(moving):
    bench = Bench()
    bench.bring_to(moving)
    bench.pressed = True
    assert bench.time_until(State.ESTOP, 1.0) <= STEP
    assert not bench.reports[-1].command.torque
    refusal = bench.supervisor.request(bench.now, Request.RESET)
    assert refusal == "RESET refused in ESTOP: e-stop pressed"
    bench.pressed = False
    assert bench.run(2.0).state is State.ESTOP
    bench.request(Request.RESET)
    assert bench.tick().state is State.IDLE


def test_a_lost_estop_source_ends_in_estop(walking):
    walking.silent.add("estop")
    took = walking.time_until(State.ESTOP, 1.0)
    assert TIMING.estop <= took <= TIMING.estop + 2 * STEP
    assert "e-stop source silent" in walking.reports[-1].reason
    assert "RESET refused" in walking.supervisor.request(walking.now, Request.RESET)
    walking.silent.clear()
    assert walking.run(1.0).state is State.ESTOP


def test_the_robot_walks_without_an_estop_source_where_none_is_required():
    bench = Bench(estop_required=False)
    bench.silent.add("estop")
    bench.bring_to(State.WALKING)
    assert bench.run(2.0).state is State.WALKING


@pytest.mark.parametrize(("roll", "pitch"), [(0.51, 0.0), (-0.51, 0.0), (0.0, 0.51), (0.0, -0.51)])
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
        s.receive_estimate(now, Estimate(wall, state(roll=1.0), np.eye(12), Validity.VALID))
    else:
        s.receive_joints(now, wall, walking.angle, load(walking.angle))
        s.receive_health(now, wall, health(hardware_error=np.full(4, 32)))
    report = walking.tick()
    assert report.state is State.WALKING
    assert (report.command.angle == 1.1).all()
    assert any(source in w and "limit 0.5 s" in w for w in report.warnings)
    assert walking.time_until(State.WALKING, 0.6) < 1.0
    walking.run(0.6)
    assert walking.supervisor.state is not State.WALKING  # rejected inputs count as missing


def test_a_fault_of_a_stamp_is_reported_once_also_if_the_next_stamp_is_right(walking):
    """Joint states come every 10 ms, a report only every 20 ms."""
    s = walking.supervisor
    s.receive_joints(walking.now, 1, walking.angle, load(walking.angle))
    assert any("joints stamped -" in warning for warning in walking.tick().warnings)
    assert walking.tick().warnings == ()


def test_a_command_older_than_the_last_is_rejected(walking):
    first = walking.now - 50_000_000
    assert "not newer" in walking.supervisor.receive_command(walking.now, first, np.full(4, 1.9))
    assert (walking.tick().command.angle == 1.1).all()


@pytest.mark.parametrize("node", SETTINGS.nodes)
def test_a_silent_node_ends_in_hold(walking, node):
    walking.silent.add(node)
    assert walking.time_until(State.HOLD, 1.0) <= TIMING.heartbeat + 2 * STEP
    assert walking.reports[-1].reason.startswith(f"node {node} silent")


def test_a_slack_or_broken_tendon_ends_in_a_hold_that_lasts(walking):
    walking.torque = np.array([0.8, 0.8, 0.0, 0.8])
    walking.time_until(State.HOLD, 2.0)
    assert walking.reports[-1].reason.startswith("slack or broken tendon RL")
    walking.torque = None
    walking.run(1.0)
    assert walking.supervisor.state is State.HOLD  # until a reset
    assert any("slack or broken tendon RL" in w for w in walking.reports[-1].warnings)


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


def test_after_repair_and_reset_the_robot_stands_again(walking):
    walking.torque = np.array([0.8, 0.8, 0.0, 0.8])
    walking.time_until(State.FAULT, 10.0)
    walking.torque = None
    walking.angle = np.full(4, 1.1)
    walking.request(Request.RESET, Request.READY, Request.STAND)
    report = walking.run(2.0)
    assert (report.state, report.warnings) == (State.STANDING, ())


def test_steady_time_does_not_go_back_with_the_clock():
    clock = SteadyClock(0.5)
    times = [clock.advance(now) for now in (0, 100, 50, 60, 10**10, 10**10 + 5, 0, 7)]
    assert times == [0, 100, 100, 110, 110, 115, 115, 122]
    assert clock.jumped.startswith("clock jumped by -10 s")


def test_relax_on_request_ends_in_idle(walking):
    walking.request(Request.RELAX)
    assert walking.time_until(State.IDLE, 3.0) <= RELAX_TIME + 2 * STEP
    assert not walking.reports[-1].command.torque


def test_a_fault_during_a_requested_relax_ends_in_fault(walking):
    walking.request(Request.RELAX)
    walking.tick()
    walking.health = dict(hardware_error=np.array([0x20, 0, 0, 0]))
    walking.tick()
    walking.health = dict()
    assert walking.time_until(State.FAULT, 3.0) <= RELAX_TIME + 2 * STEP


# Random events


def random_input(rng, bench: Bench, supervisor: Supervisor, steady: int):
    """One random input, valid or not; returns the request to make, or None."""
    now = bench.now
    wrong = rng.choice([0.0, 1.0, math.nan, math.inf, -1e9], p=[0.9, 0.04, 0.03, 0.02, 0.01])
    stamp = now - int(rng.integers(0, 40_000_000)) + int(rng.choice([0, 10**12], p=[0.99, 0.01]))
    kind = rng.integers(9)
    if kind <= 1:
        near = np.clip(bench.angle + rng.normal(0, 0.02, 4), 0, 2.0)
        angle = (near if rng.random() < 0.95 else rng.uniform(0, 2.0, 4)) + wrong
        if not supervisor.receive_command(now, stamp, angle):
            bench.servos.watchdog.offer(steady, angle)
    elif kind == 2:
        tilt = state(*rng.normal(0, 0.13, 2))
        valid = rng.choice(list(Validity), p=[0.85, 0.03, 0.08, 0.02, 0.02])
        supervisor.receive_estimate(now, Estimate(stamp, tilt + wrong, np.eye(12), Validity(valid)))
    elif kind == 3:
        angle = np.clip(bench.angle + rng.normal(0, 0.01, 4), 0, 2.0)
        torque = load(angle)
        angle[rng.integers(4)] += wrong
        supervisor.receive_joints(now, now, angle, torque)
        bits = rng.choice([0, 0x20], size=4, p=[0.9995, 0.0005])
        supervisor.receive_health(now, now, bench.servos.health(hardware_error=bits))
    elif kind == 4:
        supervisor.receive_mpc(now, int(rng.choice([0, 1, 4], p=[0.9, 0.09, 0.01])), 0)
    elif kind == 5:
        supervisor.receive_estop(now, bool(rng.random() < 0.002))
    elif kind == 6:
        for node in SETTINGS.nodes:
            supervisor.receive_heartbeat(now, node)
    elif kind == 7:
        return Request(rng.choice([*Request, *[Request.READY, Request.STAND, Request.WALK] * 6]))
    return None


def test_no_sequence_of_events_violates_the_safety_rules():
    """10,000 random events: range, rate, torque, latched states and the end of RELAX."""
    rng, bench = np.random.default_rng(11), Bench()
    supervisor, limit = bench.supervisor, ROBOT.tendon.angle_max
    before, relaxing, visited, steady = State.IDLE, 0.0, set(), 0
    times, angles = [], []
    for _ in range(10_000):
        jump = int(rng.choice([0, -(10**10), 10**10], p=[0.9996, 0.0002, 0.0002]))
        tick = int(rng.integers(0, 6_000_000))
        bench.now += tick + jump
        steady += tick
        request = random_input(rng, bench, supervisor, steady)
        granted = request is not None and supervisor.request(bench.now, request) == ""
        middle = supervisor.state
        report = supervisor.step(bench.now)
        gated = bench.servos.step(steady, report, bench.angle)
        # 1: goals are finite and within the range
        assert all(0.0 <= angle <= limit for angle in gated.angle.tolist())
        # 2: torque only where the state allows it
        assert not (report.state in OFF and gated.torque)
        assert report.action is table.ACTIONS[report.state]
        # 3: latched states are left only by a granted reset
        for old, new in ((before, middle), (middle, report.state)):
            if old in {State.ESTOP, State.FAULT} and new not in {old, State.ESTOP}:
                assert (granted, request, new) == (True, Request.RESET, State.IDLE)
        # 4: RELAX ends
        relaxing = relaxing + tick * 1e-9 if State.RELAX is before is report.state else 0.0
        assert relaxing <= RELAX_TIME + TIMING.torque_change + 0.02
        assert report.reason
        if report.state is State.READY and before is not State.READY:
            times, angles = [], []  # goals start anew at the servos' angles
        times.append(steady * 1e-9)
        angles.append(gated.angle)
        if len(times) > 5:
            moved, span = np.abs(angles[-1] - angles[-6]).max(), times[-1] - times[-6]
            assert moved <= SETTINGS.gate.rate_max * (span + SETTINGS.gate.burst) + 1e-9
        before = report.state
        visited.add(before)
        if gated.torque:
            bench.angle = gated.angle
    assert visited == set(State)
