"""No kernel is compiled while the robot moves, in whatever install and with whatever cache."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import slot_core
from slot_core.dynamics import observe

# In a process of its own: in this one, other tests may have called the kernels.
LATE_KERNELS = Path(__file__).with_name("late_kernels.py")


def output(*command, **variables):
    result = subprocess.run(
        [sys.executable, *map(str, command)],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=False,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout


@pytest.mark.parametrize(
    ("what", "scene"),
    [
        ("robot", "flat"),
        ("robot", "map"),
        ("servos", "flat"),
        ("warm_up", "flat"),
    ],
)
def test_every_kernel_of_a_walk_is_compiled_before_the_first_reading(
    what, scene
):
    """On rods, a table and emulated servos; and those of a default run by scripts/setup."""
    assert output(LATE_KERNELS, what, scene) == ""


def test_an_installed_copy_uses_the_kernels_that_the_setup_has_compiled(
    tmp_path,
):
    package = Path(slot_core.__file__).parent
    shutil.copytree(
        package,
        tmp_path / "slot_core",
        ignore=shutil.ignore_patterns("__pycache__"),
    )
    script = """if True:
        from slot_core.dynamics import observe
        print(observe.__file__, observe.points._cache.path((), observe.points.targetctx))
    """
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    file, cache = output("-c", script, PYTHONPATH=path).split()
    assert Path(file).is_relative_to(tmp_path)
    assert cache == str(
        observe.points._cache.path((), observe.points.targetctx)
    )
