"""E-stop with several sources: no other source, and no loss, releases what one has pressed."""

import pytest
from supervisor_bench import SupervisorBench, bench_in

from slot_core.clock import SECOND
from slot_core.safety.emergency_stop import EmergencyStop
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Request, State

LIMIT = read_supervisor().timing.estop


def two_sources(state=State.WALKING):
    """A bench in a state with a button and a terminal."""
    bench = SupervisorBench()
    bench.sources = {"button": False, "terminal": False}
    bench.bring_to(state)
    return bench


def press_then_lose():
    """A bench whose button was pressed and then lost, beside a terminal that is alive."""
    bench = two_sources()
    bench.sources["button"] = True
    bench.tick()
    bench.sources.pop("button")
    bench.run(3 * LIMIT)
    return bench


def test_what_one_source_has_pressed_another_one_does_not_release():
    bench = two_sources()
    bench.sources["button"] = True
    assert bench.tick().state is State.ESTOP
    for _ in range(126):
        refused = "RESET refused in ESTOP: e-stop pressed at button"
        assert bench.supervisor.request(bench.now, Request.RESET) == refused
        bench.tick()
    bench.sources["button"] = False
    bench.tick()
    bench.request(Request.RESET)
    assert bench.tick().state is State.IDLE


def test_every_source_that_has_pressed_it_has_to_release_it():
    bench = two_sources()
    bench.sources = dict.fromkeys(bench.sources, True)
    bench.tick()
    bench.sources["terminal"] = False
    bench.tick()
    assert "button" in bench.supervisor.request(bench.now, Request.RESET)
    bench.sources["button"] = False
    bench.tick()
    bench.request(Request.RESET)


def test_a_pressed_source_that_is_lost_stays_pressed_until_an_operator_says_that_it_is_gone():
    bench = press_then_lose()
    refusal = bench.supervisor.request(bench.now, Request.RESET)
    assert refusal.startswith(
        "RESET refused in ESTOP: e-stop pressed at button (silent for 1."
    )
    assert bench.supervisor.forget_estop(bench.now, "button") == ""
    bench.request(Request.RESET)
    bench.run(2 * LIMIT)
    bench.request(Request.READY)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("terminal", "terminal still sends: release it there"),
        ("knob", "knob: no source of the e-stop; known: button, terminal"),
    ],
)
def test_only_a_source_that_is_silent_can_be_forgotten(name, reason):
    bench = press_then_lose()
    assert bench.supervisor.forget_estop(bench.now, name) == reason
    assert bench.supervisor.request(bench.now, Request.RESET)


def test_the_loss_of_one_of_two_sources_stops_the_robot_and_a_reset_accepts_it():
    bench = two_sources()
    bench.sources.pop("button")
    assert LIMIT < bench.time_until(State.ESTOP, 1.0) + 0.011 < LIMIT + 0.03
    assert bench.reports[-1].reason.startswith("e-stop source button silent for 0.5")
    bench.run(LIMIT)
    bench.request(Request.RESET, Request.READY)
    assert bench.run(2 * LIMIT).state is State.READY
    bench.sources["button"] = True  # it is back
    assert bench.tick().state is State.ESTOP


def test_without_torque_a_loss_refuses_ready_until_a_reset_accepts_it():
    bench = two_sources(State.IDLE)
    bench.sources.pop("button")
    bench.run(2 * LIMIT)
    refusal = bench.supervisor.request(bench.now, Request.READY)
    assert refusal.startswith("READY refused in IDLE: e-stop source button silent for ")
    bench.request(Request.RESET, Request.READY)


def test_the_loss_of_all_sources_is_accepted_by_no_reset():
    bench = bench_in(State.READY)
    bench.sources.clear()
    bench.run(2 * LIMIT)
    assert bench.supervisor.request(bench.now, Request.RESET).startswith(
        "RESET refused in ESTOP"
    )


def test_a_source_that_leaves_is_not_missed_unless_it_is_pressed():
    stop = EmergencyStop(LIMIT, required=False)
    stop.receive(0, "terminal", pressed=False, leaving=True)
    stop.receive(0, "button", pressed=True, leaving=True)
    later = 60 * SECOND
    assert stop.lost(later) == ""
    assert stop.pressed(later) == "e-stop pressed at button (silent for 60 s)"


@pytest.mark.parametrize(
    ("required", "reason"), [(True, "no source of the e-stop"), (False, "")]
)
def test_without_any_source_motion_is_refused_only_if_one_is_required(required, reason):
    assert EmergencyStop(LIMIT, required).lost(SECOND) == reason
