"""`scripts/run` ends with exit code 1 and one line with the reason of RELAX, ESTOP or FAULT.

Real time, but for the first test: a driver's servos, and a simulation that is lost.
"""

import os
import subprocess
import sys

import pytest
from real_graph import PATIENT, changed_config

TIPPED = """
like: flat
pushes:
  tip: {time: 0.6, duration: 0.3, force: [0.0, 0.0, 0.0], moment: [4.0, 0.0, 0.0]}
"""


def run(directory, config, *options):
    return subprocess.run(
        [sys.executable, "-m", "slot_bringup", "--scene", "faulty", "--duration", "60",
         "--bag", "bag", *options],
        cwd=directory, env=os.environ | {"SLOT_CONFIG": str(config)}, capture_output=True,
        text=True, timeout=120, check=False,
    )  # fmt: skip


def message(done):
    """The line of a run that has failed."""
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    return next(text for text in done.stderr.splitlines() if text.startswith("scripts/run: "))


def test_a_run_in_lockstep_ends_with_the_limit_that_a_push_has_exceeded(tmp_path):
    """At the limits of config/, and with the same figure on every machine."""
    config = changed_config(tmp_path, {})
    (config / "scene/faulty.yaml").write_text(TIPPED)
    line = "scripts/run: the robot is in RELAX: roll +0.536 rad, limit 0.5 rad"
    assert message(run(tmp_path, config, "--lockstep")) == line


@pytest.mark.real_time
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
    done = run(tmp_path, config, "--hardware", hardware)
    assert message(done).startswith(f"scripts/run: {line}")
    if hardware == "sim":
        (file,) = (tmp_path / "bag").glob("lost_*.npz")
        assert "simulation diverged in step" in message(done)
        assert message(done).endswith(f"its state is in {file}")
