"""Messages are matched by their stamp."""

from slot_nodes.rendezvous import Rendezvous


def test_set_is_returned_when_it_is_complete():
    rendezvous = Rendezvous("a", "b", "c")
    assert rendezvous.add("c", 7, "c7") is None
    assert rendezvous.add("a", 7, "a7") is None
    assert rendezvous.add("a", 8, "a8") is None
    assert rendezvous.add("b", 7, "b7") == ("a7", "b7", "c7")


def test_lost_message_costs_only_its_own_set():
    rendezvous = Rendezvous("a", "b", depth=3)
    for stamp in range(10):
        rendezvous.add("a", stamp, stamp)
    assert rendezvous.add("b", 0, 0) is None  # dropped for newer sets
    assert rendezvous.add("b", 9, 9) == (9, 9)


def test_clock_that_is_set_back_delays_nothing():
    rendezvous = Rendezvous("a", "b", depth=3)
    for stamp in range(100, 110):
        rendezvous.add("a", stamp, stamp)
    assert rendezvous.add("a", 1, 1) is None
    assert rendezvous.add("b", 1, 1) == (1, 1)


def test_set_is_returned_once():
    rendezvous = Rendezvous("a", "b")
    rendezvous.add("a", 1, 1)
    assert rendezvous.add("b", 1, 1) == (1, 1)
    assert rendezvous.add("b", 1, 1) is None
