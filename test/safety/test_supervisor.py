"""Supervisor: table of states, requests and their refusals, commands that are followed.

Start-up without an operator: each request once, and none after a fault.

Supervised walks on slopes: the supervisor says that the robot slides, and stops it.

E-stop with several sources: no other source, and no loss, releases what one has pressed.
"""

import itertools
import math
import re

import numpy as np
import pytest
from supervisor_bench import START, STEP, TICK, SupervisorBench, bench_in, state

from slot_core.clock import SECOND
from slot_core.control.policy import Status
from slot_core.robot import GRAVITY
from slot_core.safety import states as table
from slot_core.safety.conditions import EmergencyStop
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import (
    Action,
    Condition,
    Request,
    State,
    next_state,
)
from slot_core.safety.ticked_supervisor import StartUp
from slot_core.simulation.supervised_loop import SupervisedLoop

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


READY, STAND, WALK = Request.READY, Request.STAND, Request.WALK
ALL = (READY, STAND, WALK)


def run(bench, start_up, seconds):
    for _ in range(round(100 * seconds)):
        start_up.request_next(bench.supervisor, bench.now)
        bench.tick()
    return bench.supervisor.state


def test_start_up_repeats_a_refused_request_and_returns_the_reason():
    bench, start_up = SupervisorBench(), StartUp(READY)
    bench.run(0.1)
    bench.silent.add("servos")
    bench.run(0.6)
    assert run(bench, start_up, 1.0) is State.IDLE
    assert "READY refused in IDLE: servo FL silent" in start_up.request_next(
        bench.supervisor, bench.now
    )
    bench.silent.clear()
    assert run(bench, start_up, 0.5) is State.READY


@pytest.mark.parametrize(
    ("steps", "request_", "goal"),
    [
        (ALL[:1], STAND, State.READY),  # refused: torque is not on yet
        (ALL[:2], STAND, State.STANDING),
        (ALL[:1], WALK, State.READY),  # refused too
        (ALL[:1], READY, State.READY),
        (ALL[:2], Request.RELAX, State.IDLE),
        (ALL, Request.RELAX, State.IDLE),
    ],
)
def test_start_up_makes_no_request_after_one_of_the_operator(
    steps, request_, goal
):
    """The operator's request comes when the start-up has made the first `steps`."""
    bench, start_up = SupervisorBench(), StartUp(*ALL)
    while start_up._left != list(ALL[len(steps) :]):
        run(bench, start_up, 0.01)
    bench.supervisor.request(bench.now, request_)
    assert run(bench, start_up, 3.0) is goal


@pytest.mark.parametrize(
    ("supervised", "goal"),
    [(0, State.WALKING), (START + TICK, State.WALKING), (1, State.IDLE)],
)
def test_start_up_begins_only_where_the_servos_have_obeyed_no_earlier_supervisor(
    supervised, goal
):
    bench, start_up = SupervisorBench(), StartUp(*ALL)
    bench.health["supervised"] = supervised
    assert run(bench, start_up, 3.0) is goal
    reason = start_up.request_next(bench.supervisor, bench.now)
    assert ("earlier supervisor" in reason) == (goal is State.IDLE)
    bench.health["supervised"] = 0  # the servos' node has been restarted too
    assert run(bench, start_up, 1.0) is goal


def test_start_up_makes_no_request_after_a_fault():
    bench, start_up = SupervisorBench(), StartUp(*ALL)
    bench.silent.add("command")  # STAND is refused without commands
    assert run(bench, start_up, 1.0) is State.READY
    bench.state = state(roll=1.0)
    assert run(bench, start_up, 3.0) is State.FAULT
    bench.state = state()
    bench.silent.clear()
    bench.request(Request.RESET)
    assert run(bench, start_up, 2.0) is State.IDLE


@pytest.mark.parametrize("seed", [1, 2])
@pytest.mark.parametrize(
    ("across_deg", "ends"), [(9.0, State.WALKING), (14.0, State.HOLD)]
)
def test_a_walk_across_a_slope_says_that_it_slides(across_deg, ends, seed):
    """Limits 15 and 50 mm/s; slides 28, and more than 70 mm/s aside over 5 s."""
    slope = math.radians(across_deg)
    down = (0.0, -GRAVITY * math.sin(slope), -GRAVITY * math.cos(slope))
    *_, report = SupervisedLoop(
        "flat", "walk", None, seed, changes={"scene.gravity": down}
    ).run(7.0)
    assert report.state is ends
    assert [w[:6] for w in report.warnings] == ["slides"]


LIMIT = read_supervisor().timing.estop


def two_sources(state=State.WALKING):
    """A bench in a state with a button and a terminal."""
    return bench_in(state, sources={"button": False, "terminal": False})


def refused(bench, request):
    return bench.supervisor.request(bench.now, request)


def test_every_source_that_has_pressed_it_has_to_release_it():
    bench = two_sources()
    for source in ("terminal", "button"):
        bench.sources[source] = True
        bench.tick()
    bench.sources["terminal"] = False
    for _ in range(126):
        bench.tick()
        reason = "RESET refused in ESTOP: e-stop pressed at button"
        assert refused(bench, Request.RESET) == reason
    bench.sources["button"] = False
    bench.tick()
    bench.request(Request.RESET)
    assert bench.supervisor.state is State.IDLE


def test_a_pressed_source_that_is_lost_stays_pressed_until_an_operator_forgets_it():
    bench = two_sources()
    bench.sources["button"] = True
    bench.tick()
    bench.sources.pop("button")
    bench.run(3 * LIMIT)
    forget, now = bench.supervisor.forget_estop, bench.now
    assert forget(now, "terminal") == "terminal still sends: release it there"
    unknown = "knob: no source of the e-stop; known: button, terminal"
    assert forget(now, "knob") == unknown
    reason = "RESET refused in ESTOP: e-stop pressed at button (silent for 1."
    assert refused(bench, Request.RESET).startswith(reason)
    assert forget(now, "button") == ""
    bench.request(Request.RESET)
    bench.run(2 * LIMIT)
    bench.request(Request.READY)


def test_a_reset_accepts_the_loss_of_one_of_two_sources_but_not_of_both():
    bench = two_sources()
    bench.sources.pop("button")
    bench.run(2 * LIMIT)
    bench.request(Request.RESET, Request.READY)
    assert bench.run(2 * LIMIT).state is State.READY
    bench.sources.clear()  # no reset accepts the loss of all
    bench.run(2 * LIMIT)
    assert refused(bench, Request.RESET).startswith("RESET refused in ESTOP")


def test_without_torque_a_loss_refuses_ready_until_a_reset_accepts_it():
    bench = two_sources(State.IDLE)
    bench.sources.pop("button")
    bench.run(2 * LIMIT)
    assert refused(bench, Request.READY).startswith(
        "READY refused in IDLE: e-stop source button silent for "
    )
    bench.request(Request.RESET, Request.READY)


@pytest.mark.parametrize(
    ("required", "reason"), [(True, "no source of the e-stop"), (False, "")]
)
def test_a_source_that_leaves_is_not_missed_unless_one_is_required_or_it_is_pressed(
    required, reason
):
    stop, later = EmergencyStop(LIMIT, required), 60 * SECOND
    stop.receive(0, "terminal", pressed=False, leaving=True)
    assert stop.lost(later) == reason
    stop.receive(0, "button", pressed=True, leaving=True)
    assert stop.lost(later) == ""
    assert stop.pressed(later) == "e-stop pressed at button (silent for 60 s)"
