"""`scripts/run` ends with exit code 1 and one line that says why the robot went slack."""

import os
import subprocess
import sys

import pytest
from rig import PATIENT, changed_config


@pytest.mark.parametrize(
    ("hardware", "fault", "line"),
    [
        ("fake_bus", "{kind: overload, leg: RL, time: 1.0, duration: 0.0, value: 0.0}",
         "the robot is in RELAX: servo RL: overload error, register 70 = 0x20, limit 0"),
        ("sim", "{kind: nan, leg: FL, time: 1.0, duration: 0.0, value: 0.0}",
         "sim_robot ended with exit code 1: "),
    ],
)  # fmt: skip
def test_a_run_whose_robot_gives_up_ends_in_one_line_that_says_why(tmp_path, hardware, fault, line):
    config = changed_config(tmp_path, PATIENT)
    (config / "scene/ill.yaml").write_text(f"like: flat\nfaults:\n  ill: {fault}\n")
    done = subprocess.run(
        [sys.executable, "-m", "slot_bringup", "--hardware", hardware, "--scene", "ill",
         "--duration", "60", "--bag", "bag"],
        cwd=tmp_path, env=os.environ | {"SLOT_CONFIG": str(config)}, capture_output=True,
        text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    told = next(text for text in done.stderr.splitlines() if text.startswith("scripts/run: "))
    assert told.startswith(f"scripts/run: {line}")
    assert "Traceback" not in done.stderr
    if hardware == "sim":
        (file,) = (tmp_path / "bag").glob("lost_*.npz")
        assert "simulation stopped: solution lost in step" in told
        assert told.endswith(f"its state is in {file}")
