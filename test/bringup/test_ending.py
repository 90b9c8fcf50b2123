"""End of the graph's processes."""

import subprocess

import pytest

from slot_bringup import processes
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
