"""End of the graph's processes."""

import time

import pytest

from slot_bringup import processes
from slot_bringup.graph import END, GO_ON, REFUSED, RESTART, NodeSpec


@pytest.fixture
def start(tmp_path, monkeypatch):
    """A function that starts a shell script as a node."""

    def start(script, if_it_ends=END):
        words = ["/bin/bash", "-c", script]
        monkeypatch.setattr(processes, "command_line", lambda _: words)
        started = processes.Processes(tmp_path)
        spec = NodeSpec(
            "viewer", "of_no_python_package", {}, if_it_ends=if_it_ends
        )
        started.start([spec])
        return started

    return start


@pytest.mark.parametrize(
    "end",
    [
        ("", -9, "did not end within 0.2 s of SIGINT: killed"),
        ("exit 3", 3, "ended with exit code 3: its last words"),
    ],
)
def test_a_node_that_is_killed_or_fails_at_its_end_is_named(
    start, monkeypatch, capsys, end
):
    trap, code, line = end
    if not trap:
        monkeypatch.setattr(processes, "STOP_TIMEOUT", 0.2)
    loop = "while :; do sleep 0.01; done"
    started = start(f"trap '{trap}' INT; echo its last words; echo; {loop}")
    while started.last_line("viewer") != "its last words":
        time.sleep(0.01)
    assert started.stop() == {"viewer": code}
    assert capsys.readouterr().err == f"scripts/run: viewer {line}\n"


@pytest.mark.parametrize(
    ("if_it_ends", "code"), [(END, 3), (GO_ON, REFUSED), (RESTART, REFUSED)]
)
def test_a_process_that_is_needed_or_refuses_its_configuration_ends_the_graph(
    start, if_it_ends, code
):
    started = start(f"exit {code}", if_it_ends)
    started._children["viewer"].join()
    assert started.failed() == ("viewer", code)


@pytest.mark.parametrize(
    ("if_it_ends", "restarts"), [(GO_ON, 0), (RESTART, processes.RESTARTS)]
)
def test_a_process_that_is_not_needed_is_restarted_a_few_times_then_missed(
    start, if_it_ends, restarts
):
    started = start("echo its last words; exit 3", if_it_ends)
    line = "at 1.5 s viewer ended with exit code 3: its last words; "
    started._children["viewer"].join()
    for _ in range(restarts):
        assert started.restart_ended(1.5) == [line + "restarted"]
        started._children["viewer"].join()
    assert started.restart_ended(1.5) == [line + "the robot goes on without it"]
    assert started.restart_ended(1.6) == []  # said once
    assert started.failed() is None
    assert started.missing == {"viewer"}
    assert len(started.remarks) == restarts + 1
