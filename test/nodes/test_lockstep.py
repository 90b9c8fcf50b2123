"""The nodes in lockstep, with messages that take time: equal to the core on one clock."""

import pytest

from slot_core.messages import decode
from slot_core.simulation.supervised_loop import SupervisedLoop

SECONDS = 2.0
SEED = 3


def test_states_equal_those_of_the_core_to_the_last_bit(simulate):
    """Commands too: test/graph compares them with those of the processes."""
    rig = simulate(lockstep=True, seed=SEED)
    rig.wait_for(lambda: rig.messages["/robot_state"])
    states = rig.messages["/robot_state"]
    rig.wait_for(lambda: decode.stamp(states[-1]) * 1e-9 > 1.0 + SECONDS)
    loop = SupervisedLoop("flat", "walk", None, SEED)
    reports = [(loop.plant.now, report) for report in loop.run(SECONDS)]
    states = {decode.stamp(m): m for m in states}
    assert len(reports) > 100
    for stamp, report in reports:
        assert states[stamp].state == report.state
        assert states[stamp].reason == report.reason
        assert list(states[stamp].slack) == pytest.approx(report.slack, abs=0.0, nan_ok=True)
