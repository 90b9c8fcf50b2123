"""Standing up and walking off by itself: each step once, and not again after a fault."""

import pytest
from supervised import Bench, state

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
def test_it_leads_where_it_was_asked_to(steps, goal):
    bench = Bench()
    assert run(bench, StartUp(*steps), 2.0) is goal
    assert all("by the start-up" in r.reason for r in bench.reports if r.state is goal and steps)


def test_it_waits_and_says_for_what():
    bench, start_up = Bench(), StartUp(Request.READY)
    bench.silent.add("servos")
    assert run(bench, start_up, 1.0) is State.IDLE
    assert "READY refused in IDLE: servo FL silent" in start_up.request_next(
        bench.supervisor, bench.now
    )
    bench.silent.clear()
    assert run(bench, start_up, 0.5) is State.READY


def test_a_robot_that_an_operator_has_stopped_is_not_started_again():
    bench, start_up = Bench(), StartUp(Request.READY, Request.STAND, Request.WALK)
    run(bench, start_up, 2.0)
    bench.ask(Request.RELAX)
    assert run(bench, start_up, 3.0) is State.IDLE


def test_a_fault_on_the_way_ends_it():
    bench, start_up = Bench(), StartUp(Request.READY, Request.STAND, Request.WALK)
    bench.silent.add("command")  # READY, and no further
    assert run(bench, start_up, 1.0) is State.READY
    bench.state = state(roll=1.0)
    assert run(bench, start_up, 3.0) is State.FAULT
    bench.state = state()
    bench.silent.clear()
    bench.ask(Request.RESET)
    assert run(bench, start_up, 2.0) is State.IDLE
