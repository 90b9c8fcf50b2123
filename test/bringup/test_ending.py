"""End of the graph's processes."""

import subprocess

from slot_bringup import processes
from slot_bringup.processes import Processes


def stop(tmp_path, node):
    """Exit codes after the end of a node that is this shell script, which prints "ready"."""
    started = Processes(tmp_path)
    with subprocess.Popen(
        ["bash", "-c", node], stdout=subprocess.PIPE, start_new_session=True
    ) as child:
        assert child.stdout.readline() == b"ready\n"
        started._children["node"] = child
        started.log_path("node").write_text("its last words\n\n")
        return started.stop()


def test_a_node_that_has_to_be_killed_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(processes, "STOP_TIMEOUT", 0.2)
    node = "trap '' INT; echo ready; while :; do sleep 1; done"
    assert stop(tmp_path, node) == {"node": -9}
    assert capsys.readouterr().err == (
        "scripts/run: node did not end within 0.2 s of SIGINT: killed\n"
    )


def test_a_node_that_fails_at_its_end_is_named(tmp_path, capsys):
    node = "trap 'exit 3' INT; echo ready; while :; do sleep 0.01; done"
    assert stop(tmp_path, node) == {"node": 3}
    assert capsys.readouterr().err == ("scripts/run: node ended with exit code 3: its last words\n")
