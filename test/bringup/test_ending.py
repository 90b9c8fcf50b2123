"""End of the graph's processes."""

import subprocess

import pytest

from slot_bringup import processes
from slot_bringup.graph import END, GO_ON, REFUSED, RESTART, NodeSpec
from slot_bringup.processes import Processes

KILLED = ("", -9, "node did not end within 0.2 s of SIGINT: killed")
FAILED = ("exit 3", 3, "node ended with exit code 3: its last words")


@pytest.mark.parametrize("case", [KILLED, FAILED])
def test_a_node_that_is_killed_or_fails_at_its_end_is_named(tmp_path, monkeypatch, capsys, case):
    trap, code, line = case
    if case is KILLED:
        monkeypatch.setattr(processes, "STOP_TIMEOUT", 0.2)
    node = f"trap '{trap}' INT; echo ready; while :; do sleep 0.01; done"
    started = Processes(tmp_path)
    with subprocess.Popen(
        ["bash", "-c", node], stdout=subprocess.PIPE, start_new_session=True
    ) as child:
        assert child.stdout.readline() == b"ready\n"
        started._children["node"] = child
        started.log_path("node").write_text("its last words\n\n")
        assert started.stop() == {"node": code}
    assert capsys.readouterr().err == f"scripts/run: {line}\n"


@pytest.fixture
def ended(tmp_path, monkeypatch):
    """A function that starts a process, which ends with a code; the processes."""
    monkeypatch.setattr(processes, "command_line", lambda spec: ["bash", "-c", spec.package])

    def end(if_it_ends, code):
        started = Processes(tmp_path)
        program = f"echo its last words; exit {code}"
        started.start([NodeSpec("viewer", program, {}, prefix=(), if_it_ends=if_it_ends)])
        started._children["viewer"].wait()
        return started

    return end


@pytest.mark.parametrize(("if_it_ends", "code"), [(END, 3), (GO_ON, REFUSED), (RESTART, REFUSED)])
def test_a_process_that_is_needed_or_refuses_its_configuration_ends_the_graph(
    ended, if_it_ends, code
):
    assert ended(if_it_ends, code).failed() == ("viewer", code)


@pytest.mark.parametrize(("if_it_ends", "restarts"), [(GO_ON, 0), (RESTART, processes.RESTARTS)])
def test_a_process_that_is_not_needed_is_restarted_a_few_times_then_missed(
    ended, if_it_ends, restarts
):
    started = ended(if_it_ends, 3)
    line = "at 1.5 s viewer ended with exit code 3: its last words; "
    for _ in range(restarts):
        assert started.restart_ended(1.5) == [line + "restarted"]
        started._children["viewer"].wait()
    assert started.restart_ended(1.5) == [line + "the robot goes on without it"]
    assert started.restart_ended(1.6) == []  # said once
    assert started.failed() is None
    assert started.missing == {"viewer"}
    assert len(started.remarks) == restarts + 1
