"""A run that cannot begin, is interrupted while it starts or meets a fault ends in one line."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from real_graph import changed_config, claim_domain, nodes_of

from slot_bringup import monitor
from slot_bringup.processes import Processes

# Signals that the caller ignores (SIGHUP under nohup) would be ignored in the run too.
RUN = [
    "env",
    "--default-signal=HUP,INT,TERM",
    sys.executable,
    "-m",
    "slot_bringup",
]
RUN += ["--lockstep", "--composed", "--bag"]


def test_a_supervisor_alone_is_a_second_graph_in_the_domain(
    tmp_path, monkeypatch
):
    """A real robot before its first odometry has no estimate."""
    processes = Processes(tmp_path)
    processes.start([nodes_of()["supervisor"]])
    # it ends with the first message
    monkeypatch.setattr(monitor, "DISCOVERY_TIME", 60.0)
    try:
        with pytest.raises(
            monitor.RunError,
            match=r"another graph runs in ROS domain \d+, namespace /: set another",
        ):
            monitor.require_no_other_graph()
    finally:
        processes.stop()


def run(directory, *arguments, **environment):
    return subprocess.run(
        [*RUN, *arguments],
        cwd=directory,
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def own_domain(monkeypatch):
    monkeypatch.setenv("ROS_DOMAIN_ID", claim_domain())


@pytest.mark.usefixtures("own_domain")
@pytest.mark.parametrize(
    ("process", "option"),
    [("controller", "--composed"), ("recorder", "--separate")],
)
def test_bag_that_cannot_be_written_ends_the_run_in_one_line(
    tmp_path, process, option
):
    (tmp_path / "file").touch()
    done = run(tmp_path, "file/bag", option, "--duration", "1")
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    assert (
        f"scripts/run: {process} ended with exit code 2: file/bag: cannot be written"
        in done.stderr
    )


@pytest.mark.usefixtures("own_domain")
@pytest.mark.parametrize(
    "numbers", [[signal.SIGINT] * 3, [signal.SIGTERM] * 2, [signal.SIGHUP]]
)
def test_repeated_signals_end_the_run_cleanly(tmp_path, numbers):
    """The signals arrive while the nodes are still starting."""
    child = subprocess.Popen(
        [*RUN, "bag"], cwd=tmp_path, stderr=subprocess.PIPE, text=True
    )
    ours = psutil.Process(child.pid)
    while not (
        nodes := [
            c
            for c in ours.children(recursive=True)
            if "slot_nodes/" in " ".join(c.cmdline())
        ]
    ):
        assert child.poll() is None
        time.sleep(0.01)
    for number in numbers:
        child.send_signal(number)
        time.sleep(0.1)  # so that they are not merged into one
    _, errors = child.communicate()
    assert child.returncode == 130, errors
    assert "scripts/run: interrupted, all nodes stopped" in errors
    assert "Traceback" not in errors
    assert not any(node.is_running() for node in nodes)
    assert Path(tmp_path, "bag", "log").is_dir()


FAULT = "{kind: nan, leg: RL, time: 1.0, duration: 0.0, value: 0.0}"


@pytest.mark.usefixtures("own_domain")
def test_a_simulation_that_diverges_ends_the_run_with_one_line_that_names_its_state(
    tmp_path,
):
    config = changed_config(tmp_path, {})
    scene = f"like: flat\nfaults: {{one: {FAULT}}}\n"
    (config / "scene/faulty.yaml").write_text(scene)
    options = ("--scene", "faulty", "--duration", "60")
    done = run(tmp_path, "bag", *options, SLOT_CONFIG=str(config))
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    said = next(x for x in done.stderr.splitlines() if "scripts/run: " in x)
    assert said.startswith("scripts/run: controller ended with exit code 1: ")
    assert "simulation diverged in step" in said
    (file,) = (tmp_path / "bag").glob("lost_*.npz")
    assert said.endswith(f"its state is in {file}")
