"""Programs of scripts/ in a caller's folder and shell: neither changes what they do."""

import os
import subprocess

import pytest
from real_graph import process_domain
from sourced import ROOT, environment

SLOT = str(ROOT / ".slot") + "/"
SHELL = "#!/usr/bin/env bash"
FILES = [path for path in (ROOT / "scripts").iterdir() if path.is_file()]
PROGRAMS = [path for path in FILES if path.read_text().startswith(SHELL)]
MODULES = (
    "argparse",
    "json",
    "multiprocessing",
    "numpy",
    "os",
    "random",
    "re",
    "rclpy",
    "signal",
    "slot_core",
    "yaml",
)


@pytest.fixture
def own(tmp_path):
    """A folder with modules of the caller's own, which write `ran` there."""
    for name in MODULES:
        (tmp_path / f"{name}.py").write_text(
            f"open({str(tmp_path / 'ran')!r}, 'a')\nprint('my own script')\n"
        )
    return tmp_path


@pytest.fixture
def python(own):
    """Variables of the caller's Python."""
    return {
        "MPLBACKEND": "module://own",
        "PYTHONDEVMODE": "1",
        "PYTHONHASHSEED": "own",
        "PYTHONHOME": "/nowhere",
        "PYTHONINSPECT": "1",
        "PYTHONOPTIMIZE": "2",
        "PYTHONPATH": f"{own}:",
        "PYTHONSTARTUP": str(own / "random.py"),
        "PYTHONWARNINGS": "error",
    }


def test_a_program_takes_no_settings_and_no_packages_of_the_callers_python(
    own, python
):
    isolated = environment("--isolated")
    # no current directory, in children too
    assert isolated["PYTHONSAFEPATH"] == "1"
    assert environment("--isolated", python) == isolated
    after = environment("", python)  # a shell of the caller's own keeps them
    assert "PYTHONSAFEPATH" not in after
    assert str(own) in after["PYTHONPATH"].split(":")
    kept = {
        name: value for name, value in python.items() if name != "PYTHONPATH"
    }
    assert after | kept == after


def test_a_program_runs_the_python_of_the_repository_with_packages_of_ros_workspaces():
    """Whatever was activated since scripts/env was sourced."""
    kept = [
        "/ws/install/own_msgs/lib/python3/site-packages",
        "/ws/build/own_nodes",
    ]
    given = {
        "AMENT_PREFIX_PATH": "/ws/install/own_nodes:/ws/install/own_msgs",
        "PATH": f"/own/conda/bin:{environment()['PATH']}",
        "PYTHONPATH": ":".join([kept[0], "/home/own", kept[1]]),
    }
    variables = environment("--isolated", given)
    assert variables["PATH"].startswith(f"{SLOT}venv/bin:")
    path = variables["PYTHONPATH"].split(":")
    assert [entry for entry in path if not entry.startswith(f"{ROOT}/")] == kept


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda path: path.name)
def test_every_program_is_isolated(program):
    lines = [line.strip() for line in program.read_text().splitlines()]
    sourced = [line for line in lines if line.startswith(". ")]
    ends = "scripts/env --underlay", 'env" --isolated', "env --isolated"
    assert all(
        line.endswith(ends) for line in sourced if "/scripts/help" not in line
    )


def test_a_graph_walks_in_a_folder_with_modules_of_the_callers_own(own, python):
    """Its processes are the runner and the nodes; the bag's name has quotes and spaces."""
    name = 'it\'s a "bag" of ü: 1'
    program = os.path.relpath(ROOT / "scripts/run", own)
    # with the kernels of the caller's home
    kept = {"PATH", "HOME", "XDG_CACHE_HOME"} & set(os.environ)
    given = python | {
        **{name: os.environ[name] for name in kept},
        "ROS_DOMAIN_ID": process_domain(),
        "ROS_SECURITY_ENABLE": "true",
        "CDPATH": "/",
    }
    done = subprocess.run(
        [program, "--lockstep", "--duration", "0.5", "--bag", name],
        cwd=own,
        env=given,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not (own / "ran").exists()
    assert "my own script" not in done.stdout + done.stderr
    assert (own / name / "metadata.yaml").exists()


def test_a_relative_path_is_not_looked_up_in_cdpath(tmp_path):
    (tmp_path / "scripts").mkdir()
    assert environment(given={"CDPATH": str(tmp_path)})["SLOT_ROOT"] == str(
        ROOT
    )
