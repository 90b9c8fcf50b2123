"""The launcher's choice between one process for the controller's nodes and one for each."""

from unittest.mock import Mock

import pytest

from slot_bringup import composition
from slot_bringup.arguments import parse


@pytest.mark.parametrize(
    ("cores", "load", "line"),
    [
        (2.0, 0.395, "one process: its load is 0.79 of a core, limit 0.8"),
        (2.0, 0.405, "four processes: its load is 0.81 of a core, limit 0.8"),
        (1.5, 2.0, "one process: 1.5 cores for the graph, less than 2"),
        (
            2.0,
            ValueError("no sensor"),
            "four processes: its policy fails, ValueError: no sensor",
        ),
    ],
)
def test_the_controller_has_one_process_where_one_core_carries_it_or_there_is_no_second(
    monkeypatch, cores, load, line
):
    monkeypatch.setattr(composition, "available_cores", lambda: cores)
    monkeypatch.setattr(composition, "core_load", Mock(side_effect=[load]))
    chosen = composition.choose(vars(parse([])))
    assert chosen == (line.startswith("one"), f"controller in {line}")


@pytest.mark.parametrize(
    ("words", "composed"),
    [
        (["--composed"], True),
        (["--separate"], False),
        (["--lockstep"], True),
        (["--lockstep", "--separate"], False),
    ],
)
def test_what_is_asked_for_is_not_measured(monkeypatch, words, composed):
    monkeypatch.setattr(composition, "core_load", None)  # cannot be called
    assert composition.choose(vars(parse(words))) == (composed, "")


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({}, 3.0),
        ({"cpu.max": "150000 100000"}, 1.5),
        ({"cpu.max": "900000 100000"}, 3.0),
        ({"cpu.max": "max 100000"}, 3.0),
        (
            {
                "cpu/cpu.cfs_quota_us": "50000",
                "cpu/cpu.cfs_period_us": "100000",
            },
            0.5,
        ),
        (
            {"cpu/cpu.cfs_quota_us": "-1", "cpu/cpu.cfs_period_us": "100000"},
            3.0,
        ),
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
