"""Priority of the nodes' processes."""

import os
import threading
from unittest.mock import Mock

import pytest
from rig import nodes_of

from slot_core.config import ConfigError
from slot_nodes import runtime


def test_every_thread_takes_the_priority_and_who_has_no_right_to_it_is_told(
    monkeypatch,
):
    taken, ended = [], threading.Event()
    other = threading.Thread(target=ended.wait)
    other.start()
    monkeypatch.setattr(
        runtime.ctypes, "CDLL", lambda *_, **__: Mock(mlockall=lambda _: 0)
    )
    monkeypatch.setattr(
        runtime.os, "sched_setscheduler", lambda *values: taken.append(values)
    )
    runtime.take_priority("0")
    assert taken == []
    runtime.take_priority("20")
    assert {threading.get_native_id(), other.native_id} <= {
        thread for thread, _, _ in taken
    }
    assert {(kind, given.sched_priority) for _, kind, given in taken} == {
        (os.SCHED_FIFO, 20)
    }
    monkeypatch.setattr(
        runtime.os, "sched_setscheduler", Mock(side_effect=PermissionError)
    )
    with pytest.raises(
        ConfigError, match=r"^realtime = 20: no right to this priority"
    ):
        runtime.take_priority("20")
    runtime.take_priority("")  # nobody has asked for one
    ended.set()
    other.join()


def test_the_priority_is_taken_where_there_is_a_right_to_it(monkeypatch):
    taken = set()
    monkeypatch.setattr(
        runtime.ctypes, "CDLL", lambda *_, **__: Mock(mlockall=lambda _: 0)
    )
    monkeypatch.setattr(
        runtime.os,
        "sched_setscheduler",
        lambda *values: taken.add(values[2].sched_priority),
    )
    runtime.take_priority("")
    assert taken == {runtime.PRIORITY}


@pytest.mark.parametrize(
    ("cores", "chosen", "priority"),
    [
        (2, {}, ""),  # that which the nodes may take
        (2, {"realtime": 0}, None),
        (2, {"lockstep": True}, None),
        (1, {}, None),
        (1, {"realtime": 20}, "20"),
    ],
)
def test_the_priority_that_nobody_has_asked_for(
    monkeypatch, cores, chosen, priority
):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: set(range(cores)))
    specs = nodes_of(**chosen).values()
    found = {spec.environment.get("SLOT_PRIORITY") for spec in specs}
    assert found - {None} == {priority} - {None}
