"""Supervisor: table of states, requests and their refusals, commands that are followed."""

import itertools
import math
import re

import numpy as np
import pytest
from supervisor_bench import STEP, bench_in, state

from slot_core.control.policy import Status
from slot_core.safety import states as table
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import (
    Action,
    Condition,
    Request,
    State,
    next_state,
)

SETTINGS = read_supervisor()
OFF = (State.IDLE, State.ESTOP, State.FAULT)


def test_the_estop_ends_every_state_and_commands_pass_in_two():
    for before in State:
        assert next_state(before, Condition.ESTOP_PRESSED) is State.ESTOP
        lost = next_state(before, Condition.ESTOP_LOST)
        assert lost is State.ESTOP or before in OFF
    passing = {
        s for s, action in table.ACTIONS.items() if action is Action.PASS
    }
    assert passing == {State.STANDING, State.WALKING}


def test_the_drawing_shows_the_table_but_for_the_estop():
    groups = {
        "a reason to hold": table.REASONS_TO_HOLD,
        "a fault": table.FAULTS,
    }
    drawn, real = set(), set()
    for before, after, labels in re.findall(
        "(\\w+) --> (\\w+): (.+)", table.__doc__
    ):
        for label in labels.split(", "):
            named = groups.get(label) or {Condition[label]}
            drawn |= {(State[before], c, State[after]) for c in named}
    for before, condition in itertools.product(State, list(Condition)[2:]):
        if (after := next_state(before, condition)) is not before:
            real.add((before, condition, after))
    assert drawn == real


def test_dangerous_conditions_precede_requests():
    order = list(Condition)
    requests = [c for c in Condition if c.name.endswith("_REQUESTED")]
    dangerous = [
        Condition.ESTOP_PRESSED,
        Condition.ESTOP_LOST,
        *table.REASONS_TO_RELAX,
    ]
    assert max(map(order.index, dangerous)) < min(map(order.index, requests))


def test_under_torque_the_robot_stays_until_commands_are_followed_on_request():
    assert bench_in(State.READY).reports[-1].action is Action.HOLD
    bench = bench_in(State.WALKING)
    assert bench.reports[-1].reason == "walk requested by the operator"
    bench.command = np.full(4, 1.5)
    bench.run(0.05)
    assert (bench.goals.angle == 1.5).all()


@pytest.mark.parametrize(
    ("wanted", "request_", "inputs", "text"),
    [
        (State.IDLE, Request.STAND, {}, "STAND refused in IDLE: ready first"),
        (State.IDLE, Request.WALK, {}, "WALK refused in IDLE: ready first"),
        (State.READY, Request.WALK, {}, "WALK refused in READY: stand first"),
        (State.ESTOP, Request.READY, {}, "READY refused in ESTOP: reset first"),
        (State.WALKING, Request.RESET, {}, "RESET changes nothing in WALKING"),
        (State.IDLE, Request.READY, {"silent": {"servos"}}, "servo FL silent"),
        (
            State.IDLE,
            Request.READY,
            {"state": state(pitch=-0.6)},
            "pitch -0.600 rad, limit 0.5 rad",
        ),
        (
            State.IDLE,
            Request.READY,
            {"angle": np.array([1, 1, -0.3, 1])},
            "servo RL at -0.3 rad, limits",
        ),
        (
            State.IDLE,
            Request.READY,
            {"angle": np.full(4, math.nan), "torque": np.ones(4)},
            "servo FL has not told its angle yet",
        ),
        (
            State.READY,
            Request.STAND,
            {"silent": {"command"}},
            "node force_mapper",
        ),
        (State.READY, Request.STAND, {"silent": {"estimate"}}, "no estimate"),
        (
            State.READY,
            Request.STAND,
            {"silent": {"mpc"}},
            "node mpc_controller",
        ),
        (State.READY, Request.STAND, {"status": Status.STOPPED}, "MPC"),
        (
            State.STANDING,
            Request.WALK,
            {"health": {"goal": np.full(4, 0.9)}},
            "the legs are 0.2 rad from their command, limit 0.1 rad",
        ),
        (
            State.STANDING,
            Request.WALK,
            {"health": {"goal": np.full(4, math.nan)}},
            "the legs are nan rad from their command",
        ),
    ],
)
def test_a_request_is_refused_for_the_state_or_the_inputs(
    wanted, request_, inputs, text
):
    bench = bench_in(wanted)
    vars(bench).update(inputs)
    bench.run(0.6 if "silent" in inputs else 0.05)
    assert text in bench.supervisor.request(bench.now, request_)
    assert bench.tick().state is wanted


def test_the_commands_are_followed_from_when_the_legs_have_reached_them():
    bench = bench_in(State.READY, command=np.full(4, 1.9))
    bench.request(Request.STAND)
    assert not bench.reports[-1].followed
    while not bench.tick().followed:
        assert np.abs(bench.angle - 1.9).max() > SETTINGS.arrived - STEP
    bench.command = np.full(4, 1.2)  # from then on any command is
    assert bench.run(0.5).followed
