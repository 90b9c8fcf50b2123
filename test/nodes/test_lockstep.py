"""The nodes in lockstep, with messages that take time: equal to the core on one clock."""

import pytest

from slot_core.messages import decode
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
