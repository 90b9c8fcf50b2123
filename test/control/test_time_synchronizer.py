"""Messages are matched by their stamp."""

from slot_core.estimation.time_synchronizer import TimeSynchronizer


def test_set_is_returned_when_it_is_complete():
    synchronizer = TimeSynchronizer("a", "b", "c")
    assert synchronizer.add("c", 7, "c7") is None
    assert synchronizer.add("a", 7, "a7") is None
    assert synchronizer.add("a", 8, "a8") is None
    assert synchronizer.add("b", 7, "b7") == ("a7", "b7", "c7")


def test_lost_message_costs_only_its_own_set():
    synchronizer = TimeSynchronizer("a", "b", depth=3)
    for stamp in range(10):
        synchronizer.add("a", stamp, stamp)
    assert synchronizer.add("b", 0, 0) is None  # dropped for newer sets
    assert synchronizer.add("b", 9, 9) == (9, 9)


def test_clock_that_is_set_back_delays_nothing():
    synchronizer = TimeSynchronizer("a", "b", depth=3)
    for stamp in range(100, 110):
        synchronizer.add("a", stamp, stamp)
    assert synchronizer.add("a", 1, 1) is None
    assert synchronizer.add("b", 1, 1) == (1, 1)


def test_set_is_returned_once():
    synchronizer = TimeSynchronizer("a", "b")
    synchronizer.add("a", 1, 1)
    assert synchronizer.add("b", 1, 1) == (1, 1)
    assert synchronizer.add("b", 1, 1) is None
