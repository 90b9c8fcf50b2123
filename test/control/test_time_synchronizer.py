"""Messages are matched by their stamp."""

import pytest

from slot_core.estimation.time_synchronizer import TimeSynchronizer

OLD = [("b", stamp) for stamp in range(100, 110)]
# messages by topic and stamp, and which of them complete a set
CASES = {
    "in any order": ([("b", 7), ("a", 8), ("a", 7)], [2]),
    "once": ([("a", 1), ("b", 1), ("b", 1)], [1]),
    "a lost one costs its own set alone": (
        [*OLD, ("a", 100), ("a", 109)],
        [11],
    ),
    "a clock set back delays nothing": ([*OLD, ("a", 1), ("b", 1)], [11]),
}


@pytest.mark.parametrize("case", CASES)
def test_a_set_is_returned_when_it_is_complete(case):
    messages, complete = CASES[case]
    synchronizer = TimeSynchronizer("a", "b", depth=3)
    for number, (topic, stamp) in enumerate(messages):
        found = synchronizer.add(topic, stamp, f"{topic}{stamp}")
        expected = (f"a{stamp}", f"b{stamp}") if number in complete else None
        assert found == expected
