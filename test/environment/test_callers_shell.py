"""Programs of scripts/ in a caller's folder and shell: neither changes what they do."""

import os
import shlex
import subprocess

import pytest
from real_graph import process_domain
from sourced import ROOT, environment

SLOT = str(ROOT / ".slot") + "/"
SHELL = "#!/usr/bin/env bash"
FILES = [path for path in (ROOT / "scripts").iterdir() if path.is_file()]
PROGRAMS = [path for path in FILES if path.read_text().startswith(SHELL)]


def test_a_program_takes_no_settings_and_no_packages_of_the_callers_python(caller):
    own = environment("--isolated")
    assert own["PYTHONSAFEPATH"] == "1"  # no current directory, in child processes too
    assert environment("--isolated", caller.python) == own


def test_a_program_runs_the_python_of_the_repository_whatever_was_activated_since():
    path = environment()["PATH"]
    activated = environment("--isolated", {"PATH": f"/own/conda/bin:{path}"})["PATH"]
    assert activated.startswith(f"{SLOT}venv/bin:")


def test_a_program_keeps_the_packages_of_ros_workspaces_that_were_sourced():
    kept = ["/ws/install/own_msgs/lib/python3/site-packages", "/ws/build/own_nodes"]
    given = {
        "AMENT_PREFIX_PATH": "/ws/install/own_nodes:/ws/install/own_msgs",
        "PYTHONPATH": ":".join([kept[0], "/home/own", kept[1]]),
    }
    path = environment("--isolated", given)["PYTHONPATH"].split(":")
    assert [entry for entry in path if not entry.startswith(f"{ROOT}/")] == kept


def test_a_shell_of_the_callers_own_keeps_its_python(caller):
    after = environment("", caller.python)
    assert "PYTHONSAFEPATH" not in after
    assert str(caller.folder) in after["PYTHONPATH"].split(":")
    assert caller.python.items() - after.items() == {
        ("PYTHONPATH", caller.python["PYTHONPATH"])
    }


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda path: path.name)
def test_every_program_is_isolated(program):
    lines = [line.strip() for line in program.read_text().splitlines()]
    sourced = [
        line for line in lines if line.startswith(". ") and "/scripts/help" not in line
    ]
    assert all(
        line.endswith(("scripts/env --underlay", 'env" --isolated', "env --isolated"))
        for line in sourced
    )


def test_a_graph_walks_in_a_folder_with_modules_of_the_callers_own(caller):
    """Its processes are the runner and the nodes; the bag's name has quotes and spaces."""
    name = 'it\'s a "bag" of ü: 1'
    program = os.path.relpath(ROOT / "scripts/run", caller.folder)
    given = {
        "PATH": os.environ["PATH"],
        "ROS_DOMAIN_ID": process_domain(),
        "CDPATH": "/",
    }
    done = subprocess.run(
        [
            "bash",
            "-c",
            f"{program} --lockstep --duration 0.5 --bag {shlex.quote(name)}",
        ],
        cwd=caller.folder,
        env=given | caller.python | {"ROS_SECURITY_ENABLE": "true"},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert not caller.ran
    assert "my own script" not in done.stdout + done.stderr
    assert (caller.folder / name / "metadata.yaml").exists()


def test_a_relative_path_is_not_looked_up_in_cdpath(tmp_path):
    (tmp_path / "scripts").mkdir()
    assert environment(given={"CDPATH": str(tmp_path)})["SLOT_ROOT"] == str(ROOT)
