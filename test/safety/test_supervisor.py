"""Supervisor: every fault in its time limit; only a reset leads out of ESTOP and FAULT."""

import itertools
import math

import numpy as np
import pytest
from supervisor_bench import STEP, SupervisorBench, bench_in, state

from slot_core.control.policy import Status
from slot_core.safety import states as table
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import (
    LATCHED,
    TO_RISE,
    TO_STAND,
    TO_WALK,
    Action,
    Condition,
    Request,
    State,
    next_state,
)

SETTINGS = read_supervisor()
OFF = (State.IDLE, State.ESTOP, State.FAULT)


# The table


def test_the_table_covers_every_state_and_condition():
    assert list(table.TRANSITIONS) == list(Condition)  # in the order of urgency
    for state_, condition in itertools.product(State, Condition):
        assert isinstance(next_state(state_, condition), State)
    assert set(table.ACTIONS) == set(State)
    for state_ in State:
        assert next_state(state_, Condition.ESTOP_PRESSED) is State.ESTOP
        assert next_state(state_, Condition.ESTOP_LOST) is State.ESTOP or state_ in OFF


@pytest.mark.parametrize("latched", [State.ESTOP, State.FAULT])
def test_only_a_reset_leads_out_of_estop_and_fault(latched):
    exits = {
        c: next_state(latched, c)
        for c in Condition
        if next_state(latched, c) is not latched
    }
    assert exits.pop(Condition.RESET_REQUESTED) is State.IDLE
    assert set(exits.values()) <= {
        State.ESTOP
    }  # the e-stop has precedence over a fault


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
    assert {s for s, action in table.ACTIONS.items() if action is Action.OFF} == set(
        OFF
    )


def test_the_diagram_shows_the_table():
    drawn = set()
    groups = {"a reason to hold": table.REASONS_TO_HOLD, "a fault": table.FAULTS}
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
    bench = SupervisorBench()
    bench.run(0.3)
    assert not bench.goals.torque
    bench.request(Request.READY)
    assert bench.tick().action is Action.HOLD
    bench.run(0.02)
    bench.request(Request.STAND)
    assert bench.run(1.0).state is State.STANDING
    bench.request(Request.WALK)
    report = bench.run(1.0)
    assert report.state is State.WALKING
    assert report.reason == "walk requested by the operator"
    assert report.warnings == ()
    bench.command = np.full(4, 1.5)
    bench.run(0.05)
    assert (bench.goals.angle == 1.5).all()


@pytest.mark.parametrize("way", [TO_RISE, TO_STAND, TO_WALK])
def test_no_way_to_a_state_leads_out_of_an_emergency_stop_or_a_fault(way):
    assert way.keys().isdisjoint(LATCHED)
    assert Request.RESET not in way.values()


def test_the_way_to_stand_ends_standing():
    assert State.STANDING not in TO_RISE | TO_STAND


@pytest.mark.parametrize(
    ("wanted", "request_", "text"),
    [
        (State.IDLE, Request.STAND, "STAND refused in IDLE: ready first"),
        (State.IDLE, Request.WALK, "WALK refused in IDLE: ready first"),
        (State.READY, Request.WALK, "WALK refused in READY: stand first"),
        (State.ESTOP, Request.READY, "READY refused in ESTOP: reset first"),
        (State.FAULT, Request.READY, "READY refused in FAULT: reset first"),
        (State.FAULT, Request.WALK, "WALK refused in FAULT: reset first"),
        (State.WALKING, Request.RESET, "RESET changes nothing in WALKING"),
    ],
)
def test_a_request_that_the_state_does_not_allow_is_refused(wanted, request_, text):
    bench = bench_in(wanted)
    assert bench.supervisor.request(bench.now, request_) == text
    assert bench.tick().state is wanted


@pytest.mark.parametrize(
    ("cause", "text"),
    [
        (lambda b: b.sources.clear(), "no source of the e-stop"),
        (lambda b: b.silent.add("servos"), "servo FL silent"),
        (
            lambda b: setattr(b, "state", state(pitch=-0.6)),
            "pitch -0.600 rad, limit 0.5 rad",
        ),
        (
            lambda b: setattr(b, "angle", np.array([1, 1, -0.3, 1])),
            "servo RL at -0.3 rad, limits",
        ),
        (
            lambda b: setattr(b.supervisor, "receive_joints", lambda *_: None),
            "servo FL has not",
        ),
    ],
    ids=["estop", "servos", "tilt", "zero", "unknown"],
)
def test_ready_is_refused_during_a_fault(cause, text):
    bench = SupervisorBench(**{"timing.estop": 0.3, "timing.servo_silent": 0.3})
    cause(bench)
    bench.run(0.5)
    refusal = bench.supervisor.request(bench.now, Request.READY)
    assert refusal.startswith("READY refused in IDLE: ")
    assert text in refusal
    assert bench.tick().state is State.IDLE


@pytest.mark.parametrize(
    "missing", ["command", "estimate", "solution", *SETTINGS.nodes]
)
def test_stand_is_refused_while_an_input_is_missing(missing):
    bench = bench_in(State.READY)
    bench.silent.add(missing)
    bench.status = Status.STOPPED if missing == "solution" else Status.SOLVED
    bench.run(0.6)
    assert bench.supervisor.request(bench.now, Request.STAND).startswith(
        "STAND refused in READY"
    )
    assert bench.tick().state is State.READY


def test_walk_is_refused_far_from_the_command():
    bench = bench_in(State.STANDING)
    bench.command = np.full(4, 1.9)
    bench.run(0.05)
    assert "from their command, limit 0.1 rad" in bench.supervisor.request(
        bench.now, Request.WALK
    )


def test_the_commands_are_followed_from_when_the_legs_have_reached_them():
    bench = SupervisorBench()
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


def test_walk_is_refused_while_the_goals_of_the_servos_are_unknown():
    bench = bench_in(State.STANDING)
    bench.run(1.0)
    bench.health = {"goal": np.full(4, math.nan)}
    bench.run(0.1)
    reason = bench.supervisor.request(bench.now, Request.WALK)
    assert "the legs are nan rad from their command" in reason


def test_a_broken_tendon_is_found_after_the_clock_was_set_back():
    """Readings with stamps of before count as new."""
    walking = bench_in(State.WALKING)
    walking.now -= 3_600_000_000_000
    walking.tick()
    assert walking.supervisor.state is State.HOLD
    assert walking.time_until(State.WALKING, 1.0) < 1.0
    walking.run(2.0)
    walking.torque = np.zeros(4)
    assert walking.time_until(State.HOLD, 3.0) < 3.0
    assert "slack or broken tendon" in walking.reports[-1].reason
