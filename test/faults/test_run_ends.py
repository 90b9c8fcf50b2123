"""`scripts/run` ends with exit code 1 and one line with the reason of RELAX, ESTOP or FAULT.

Real time: the run's processes, their exit codes and its output.
"""

import os
import subprocess
import sys

import pytest
from real_graph import PATIENT, changed_config

pytestmark = pytest.mark.real_time


@pytest.mark.parametrize(
    ("hardware", "fault", "line"),
    [
        ("fake_bus", "{kind: overload, leg: RL, time: 1.0, duration: 0.0, value: 0.0}",
         "the robot is in RELAX: servo RL: overload error, register 70 = 0x20, limit 0"),
        ("sim", "{kind: nan, leg: FL, time: 1.0, duration: 0.0, value: 0.0}",
         "sim_robot ended with exit code 1: "),
    ],
)  # fmt: skip
def test_a_run_ends_with_one_line_that_names_the_robots_fault(tmp_path, hardware, fault, line):
    config = changed_config(tmp_path, PATIENT)
    (config / "scene/faulty.yaml").write_text(f"like: flat\nfaults:\n  one: {fault}\n")
    done = subprocess.run(
        [sys.executable, "-m", "slot_bringup", "--hardware", hardware, "--scene", "faulty",
         "--duration", "60", "--bag", "bag"],
        cwd=tmp_path, env=os.environ | {"SLOT_CONFIG": str(config)}, capture_output=True,
        text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    message = next(text for text in done.stderr.splitlines() if text.startswith("scripts/run: "))
    assert message.startswith(f"scripts/run: {line}")
    assert "Traceback" not in done.stderr
    if hardware == "sim":
        (file,) = (tmp_path / "bag").glob("lost_*.npz")
        assert "simulation diverged in step" in message
        assert message.endswith(f"its state is in {file}")
