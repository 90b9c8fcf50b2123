"""The launcher's choice between one process for the controller's nodes and one for each."""

from types import SimpleNamespace

import pytest

from slot_bringup import composition
from slot_bringup.arguments import parse


@pytest.fixture
def machine(monkeypatch):
    """A machine with two cores, whose controller takes a quarter of one; both can be changed."""
    found = SimpleNamespace(cores=2.0, load=0.25)
    monkeypatch.setattr(composition, "available_cores", lambda: found.cores)
    monkeypatch.setattr(composition, "core_load", lambda *_: found.load)
    return found


def choose(*words):
    return composition.choose(vars(parse(words)))


@pytest.mark.parametrize(
    ("cores", "load", "line"),
    [
        (2.0, 0.395, "one process: its load is 0.79 of a core, limit 0.8"),
        (2.0, 0.405, "four processes: its load is 0.81 of a core, limit 0.8"),
        (1.5, 2.0, "one process: 1.5 cores for the graph, less than 2"),
    ],
)
def test_the_controller_has_one_process_where_one_core_carries_it_or_there_is_no_second(
    machine, cores, load, line
):
    machine.cores, machine.load = cores, load
    assert choose() == (line.startswith("one"), f"controller in {line}")


def test_what_is_asked_for_is_not_measured(monkeypatch):
    monkeypatch.setattr(composition, "core_load", None)  # cannot be called
    assert choose("--composed") == (True, "")
    assert choose("--separate") == (False, "")
    assert choose("--lockstep") == (True, "")
    assert choose("--lockstep", "--separate") == (False, "")


def test_a_policy_that_fails_has_a_process_of_its_own(machine, monkeypatch):
    def fail(*_):
        raise ValueError("no sensor")

    monkeypatch.setattr(composition, "core_load", fail)
    line = "controller in four processes: its policy fails, ValueError: no sensor"
    assert choose() == (False, line)


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({}, 3.0),
        ({"cpu.max": "150000 100000"}, 1.5),
        ({"cpu.max": "900000 100000"}, 3.0),
        ({"cpu.max": "max 100000"}, 3.0),
        ({"cpu/cpu.cfs_quota_us": "50000", "cpu/cpu.cfs_period_us": "100000"}, 0.5),
        ({"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"}, 3.0),
    ],
)
def test_cores_are_those_of_the_affinity_within_the_quota_of_the_container(
    monkeypatch, tmp_path, files, cores
):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 2, 5})
    (tmp_path / "cpu").mkdir()
    for name, text in files.items():
        (tmp_path / name).write_text(f"{text}\n")
    assert composition.available_cores(tmp_path) == cores


def test_the_load_is_the_cpu_time_of_the_ticks_over_their_period(monkeypatch):
    """A clock that goes on by 4 ms with each tick; 33 ms between two of them."""
    times = iter(0.004 * (n // 2 + n % 2) for n in range(10_000))
    monkeypatch.setattr("time.thread_time", lambda: next(times))
    load = composition.core_load("gait_alone", "walk")
    assert load == pytest.approx(0.004 / 0.033, rel=0.02)
