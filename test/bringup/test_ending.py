"""End of the graph's processes."""

import subprocess

from slot_bringup import processes
from slot_bringup.processes import Processes


def test_a_node_that_has_to_be_killed_is_named(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(processes, "STOP_TIMEOUT", 0.2)
    started, deaf = Processes(tmp_path), "trap '' INT; echo ready; while :; do sleep 1; done"
    child = subprocess.Popen(["bash", "-c", deaf], stdout=subprocess.PIPE, start_new_session=True)
    assert child.stdout.readline() == b"ready\n"
    started._children["deaf"] = child
    assert started.stop() == {"deaf": -9}
    child.stdout.close()
    assert capsys.readouterr().err == (
        "scripts/run: deaf did not end within 0.2 s of SIGINT: killed\n"
    )
