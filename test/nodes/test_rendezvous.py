"""Messages meet by their stamp."""

from slot_nodes.rendezvous import Rendezvous


def test_a_set_is_handed_out_when_it_is_complete():
    meet = Rendezvous("a", "b", "c")
    assert meet.add("c", 7, "c7") is None
    assert meet.add("a", 7, "a7") is None
    assert meet.add("a", 8, "a8") is None
    assert meet.add("b", 7, "b7") == ("a7", "b7", "c7")


def test_a_lost_message_costs_its_own_set_only():
    meet = Rendezvous("a", "b", depth=3)
    for stamp in range(10):
        meet.add("a", stamp, stamp)
    assert meet.add("b", 0, 0) is None  # forgotten: newer sets have pushed it out
    assert meet.add("b", 9, 9) == (9, 9)


def test_a_clock_that_was_set_back_holds_nothing_up():
    meet = Rendezvous("a", "b", depth=3)
    for stamp in range(100, 110):
        meet.add("a", stamp, stamp)
    assert meet.add("a", 1, 1) is None
    assert meet.add("b", 1, 1) == (1, 1)


def test_a_set_is_handed_out_once():
    meet = Rendezvous("a", "b")
    meet.add("a", 1, 1)
    assert meet.add("b", 1, 1) == (1, 1)
    assert meet.add("b", 1, 1) is None
