"""E-stop with several sources: no other source, and no loss, releases what one has pressed."""

import pytest
from supervisor_bench import bench_in

from slot_core.clock import SECOND
from slot_core.safety.conditions import EmergencyStop
from slot_core.safety.settings import read_supervisor
from slot_core.safety.states import Request, State

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
