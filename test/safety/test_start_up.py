"""Start-up without an operator: each request once, and none after a fault."""

import pytest
from supervisor_bench import START, TICK, SupervisorBench, state

from slot_core.safety.states import Request, State
from slot_core.safety.ticked_supervisor import StartUp

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
