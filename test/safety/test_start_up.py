"""Start-up without an operator: each request once, and none after a fault."""

import pytest
from supervisor_bench import SupervisorBench, state

from slot_core.safety.start_up import StartUp
from slot_core.safety.states import State
from slot_core.safety.supervisor import Request


def run(bench, start_up, seconds):
    for _ in range(round(100 * seconds)):
        start_up.request_next(bench.supervisor, bench.now)
        bench.tick()
    return bench.supervisor.state


@pytest.mark.parametrize(
    ("steps", "goal"),
    [
        ((Request.READY, Request.STAND), State.STANDING),
        ((Request.READY, Request.STAND, Request.WALK), State.WALKING),
        ((), State.IDLE),
    ],
)
def test_start_up_reaches_the_state_of_its_last_request(steps, goal):
    bench = SupervisorBench()
    assert run(bench, StartUp(*steps), 2.0) is goal
    assert all("by the start-up" in r.reason for r in bench.reports if r.state is goal and steps)


def test_start_up_repeats_a_refused_request_and_returns_the_reason():
    bench, start_up = SupervisorBench(), StartUp(Request.READY)
    bench.silent.add("servos")
    assert run(bench, start_up, 1.0) is State.IDLE
    assert "READY refused in IDLE: servo FL silent" in start_up.request_next(
        bench.supervisor, bench.now
    )
    bench.silent.clear()
    assert run(bench, start_up, 0.5) is State.READY


def test_start_up_makes_no_request_after_the_operators_relax():
    bench, start_up = SupervisorBench(), StartUp(Request.READY, Request.STAND, Request.WALK)
    run(bench, start_up, 2.0)
    bench.request(Request.RELAX)
    assert run(bench, start_up, 3.0) is State.IDLE


def test_start_up_makes_no_request_after_a_fault():
    bench, start_up = SupervisorBench(), StartUp(Request.READY, Request.STAND, Request.WALK)
    bench.silent.add("command")  # STAND is refused without commands
    assert run(bench, start_up, 1.0) is State.READY
    bench.state = state(roll=1.0)
    assert run(bench, start_up, 3.0) is State.FAULT
    bench.state = state()
    bench.silent.clear()
    bench.request(Request.RESET)
    assert run(bench, start_up, 2.0) is State.IDLE
