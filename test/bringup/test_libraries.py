"""Programs in a terminal in which scripts/env was not sourced."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = (
    ROOT / "src" / "slot_core",
    ROOT / "src" / "slot_nodes",
    ROOT / "slot_bringup",
)


def test_a_program_under_another_python_finds_them_behind_its_own_packages():
    """As `ros2 launch`, in a terminal in which scripts/env was sourced."""
    done = subprocess.run(
        [
            sys.executable,
            "-S",
            "-c",
            "import slot_bringup, sys; print(*sys.path, sep='\\n')",
        ],
        env={
            "PYTHONPATH": os.pathsep.join(map(str, PACKAGES)),
            "VIRTUAL_ENV": sys.prefix,
        },
        capture_output=True,
        text=True,
        check=True,
    )
    *others, last = done.stdout.splitlines()
    assert Path(last).parents[2] == Path(sys.prefix)
    assert last not in others


@pytest.mark.parametrize(
    "module", ["slot_nodes.mpc_controller_node", "slot_bringup.run"]
)
def test_a_program_without_its_libraries_says_in_one_line_what_to_source(
    module,
):
    # -S leaves out the packages installed for this Python
    done = subprocess.run(
        [sys.executable, "-S", "-c", f"import {module}"],
        env={"PYTHONPATH": os.pathsep.join(map(str, PACKAGES))},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "scipy" in line
    assert "source scripts/env" in line
