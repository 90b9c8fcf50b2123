"""The container of the robot: its commands as a shell makes them, and the revision in its bags."""

import os
import re
import shlex
import subprocess
from pathlib import Path

import pytest
import yaml

from slot_bringup.graph import read_graph
from slot_bringup.servos import main
from slot_core.recording import origin

ROOT = Path(__file__).parents[2]
COMPOSE = yaml.safe_load((ROOT / "docker/compose.yaml").read_text())
ROBOTS = {name: COMPOSE["services"][name] for name in ("robot", "camera")}
LAUNCH = {"robot": "slot.launch.py", "camera": "d435_rtabmap.launch.py"}


@pytest.mark.parametrize(("record", "bags"), [("1", 1), ("", 0)])
@pytest.mark.parametrize("service", ROBOTS)
def test_the_container_of_the_robot_records_to_the_host(service, record, bags):
    """Compose replaces ${NAME:-default} and $$ in the command."""
    default = re.compile(r"(?<!\$)\$\{\w+:-(.*?)\}")
    text = default.sub(r"\1", ROBOTS[service]["command"]).replace("$$", "$")
    command = shlex.split(text.replace("exec ros2", "echo ros2"))
    environment = {"PATH": "/usr/bin:/bin", "SLOT_RECORD": record}
    words = subprocess.check_output(command, text=True, env=environment).split()
    assert words[:4] == ["ros2", "launch", "slot_bringup", LAUNCH[service]]
    given = dict(word.split(":=") for word in words[4:])
    assert set(given) <= {argument.name for argument in read_graph().arguments}
    found = [value for name, value in given.items() if name == "bag"]
    assert len(found) == bags
    assert all(
        re.fullmatch(r"/slot/bags/robot_\d{8}_\d{6}", value) for value in found
    )
    assert "../bags:/slot/bags" in ROBOTS[service]["volumes"]


def test_the_tools_of_the_servos_run_in_the_container(tmp_path, capsys):
    """As the page has it, at the device that is passed in."""
    (words,) = re.findall(
        r"run --rm servos (.*)",
        (ROOT / "slot_bringup/doc/hardware.md").read_text(),
    )
    service, port = COMPOSE["services"]["servos"], str(tmp_path / "ttyUSB0")
    *programs, option, device = service["entrypoint"]
    assert [os.access(ROOT / name, os.X_OK) for name in programs] == [True] * 2
    assert [device] == service["devices"] == ROBOTS["robot"]["devices"]
    assert "../config:/slot/config" in service["volumes"]
    assert main([option, port, *words.split()]) == 1
    assert capsys.readouterr().err.startswith(f"scripts/servos: {port}: ")


def test_an_image_without_git_names_its_commit(monkeypatch, tmp_path):
    assert "SLOT_REVISION" in COMPOSE["x-slot"]["build"]["args"]
    monkeypatch.setattr(origin, "__file__", str(tmp_path / "origin.py"))
    monkeypatch.setenv("SLOT_REVISION", "1234abc-dirty")
    assert origin.revision() == "1234abc-dirty"
