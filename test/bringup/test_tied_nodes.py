"""No node outlives the process that started it: scripts/run or ros2 launch."""

import os
import signal
import subprocess

import pytest

from slot_bringup.graph import NodeSpec
from slot_bringup.processes import command_line


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_node_that_compiles_its_kernels_ends_at_a_signal(number, tmp_path):
    node = subprocess.Popen(
        command_line(NodeSpec("sim_robot", "slot_nodes", {})),
        env=os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    try:
        assert "preparing; a first start compiles" in node.stderr.readline()
        node.send_signal(number)
        node.communicate()
        assert node.returncode == 0
        # of 5 kernels: it has not gone on
        assert len(list(tmp_path.glob("*.kernel"))) < 4
    finally:
        node.kill()
