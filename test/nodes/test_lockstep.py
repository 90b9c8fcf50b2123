"""The nodes in lockstep, with messages that take time: equal to the core on one clock."""

import pytest

from slot_core.messages import decode
from slot_core.safety.states import State
from slot_core.simulation.supervised_loop import SupervisedLoop

SECONDS = 2.0
SEED = 3


@pytest.fixture
def rig(simulate):
    made = simulate(lockstep=True, seed=SEED)
    made.wait_for(lambda: newest(made) > 1.0 + SECONDS)
    yield made
    made.close()


def newest(rig):
    """Time of the robot, s, at the supervisor's newest state."""
    states = rig.messages["/robot_state"]
    return decode.stamp(states[-1]) * 1e-9 if states else 0.0


def test_the_supervisor_answers_every_report_of_the_servos(rig):
    states = [decode.stamp(m) for m in rig.messages["/robot_state"]]
    reports = {decode.stamp(m) for m in rig.messages["/servo_health"]}  # repeated at rest
    assert states == sorted(reports)[: len(states)]
    assert len(reports) - len(states) <= 1
    assert (states[-1] - states[0]) / (len(states) - 1) == 20_000_000
    assert rig.state is State.WALKING


def test_states_equal_those_of_the_core_to_the_last_bit(rig):
    """Commands too: test/graph compares them with those of the processes."""
    loop = SupervisedLoop("flat", "walk", None, SEED)
    reports = [(loop.plant.now, report) for report in loop.run(SECONDS)]
    states = {decode.stamp(m): m for m in rig.messages["/robot_state"]}
    assert len(reports) > 100
    for stamp, report in reports:
        assert states[stamp].state == report.state
        assert states[stamp].reason == report.reason
        assert list(states[stamp].slack) == pytest.approx(report.slack, abs=0.0, nan_ok=True)


def test_the_estop_holds_from_the_next_step_on(rig):
    assert rig.request("estop") == ""
    pressed = newest(rig)
    rig.wait_for(lambda: newest(rig) > pressed + 0.1)
    (since, state, reason) = rig.transitions[-1]
    assert (state, reason) == (State.ESTOP, "e-stop pressed by the operator")
    assert 0.0 <= since * 1e-9 - pressed < 0.021  # a state is on its way to the test
    off = [decode.stamp(m) * 1e-9 for m in rig.messages["/servo_health"] if not any(m.torque)]
    # the next step publishes ESTOP, the report after it says that torque is off
    assert pressed < off[0] < pressed + 0.061
