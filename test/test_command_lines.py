"""The command line tools refuse what they cannot do in one line, with exit code 2."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks import __main__ as command_line
from slot_bringup import run
from slot_bringup.graph import read_graph
from slot_core.config import ConfigError
from slot_core.legs import leg_map
from slot_core.mpc.settings import read_mpc
from slot_lab.report import constraint_map
from slot_lab.tuning import tune

ROOT = Path(__file__).parents[1]
WALK = ROOT / "test" / "bags" / "walk"


def refusal(call, capsys):
    """The one line on the standard error of a call that ends with exit code 2."""
    try:
        code = call()
    except SystemExit as ended:
        code = ended.code
    assert code == 2
    lines = capsys.readouterr().err.splitlines()
    assert "Traceback" not in "".join(lines)
    return lines[-1]


WITHOUT_EXTRAS = """
import runpy, sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in %r:
            raise ModuleNotFoundError(f"No module named {name!r}")
sys.meta_path.insert(0, Missing())
sys.argv = ["", "--help"]
runpy.run_module(%r, run_name="__main__", alter_sys=True)
"""
EXTRAS = ("cma", "cvxpy", "distributed", "elastica", "mujoco", "pytest", "quadprog", "rerun")


def programs():
    """Python modules by the command of scripts/ that runs them."""
    for script in sorted((ROOT / "scripts").iterdir()):
        if script.is_file() and not script.suffix:
            for module in re.findall(r"^exec python -m ([\w.]+)", script.read_text(), re.MULTILINE):
                yield script.name, module


@pytest.mark.parametrize(("script", "module"), programs())
def test_every_help_works_without_the_packages_of_an_extra(script, module):
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT_EXTRAS % (EXTRAS, module)],
        capture_output=True, text=True, cwd=ROOT / "scripts", check=False,
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert run.stdout.startswith(f"usage: scripts/{script} ")


def test_a_new_file_of_the_configuration_costs_no_rebuild():
    setup = (ROOT / "scripts" / "setup").read_text()
    (inputs,) = re.findall(r"^workspace_state\(\).*?^\)", setup, re.MULTILINE | re.DOTALL)
    assert "slot_msgs" in inputs
    assert "config" not in inputs


def test_a_leg_map_into_a_directory_that_is_not_there_is_refused_before_the_work(tmp_path, capsys):
    out = tmp_path / "nowhere" / "map.csv"
    line = refusal(lambda: leg_map.main(["--out", str(out)]), capsys)
    assert line.endswith(f"--out {out}: not a file in an existing directory")


@pytest.mark.parametrize("text", [None, "", "nodes: many\n"])
def test_a_leg_map_without_its_configuration_is_refused(tmp_path, monkeypatch, capsys, text):
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    if text is not None:
        (tmp_path / "leg_map.yaml").write_text(text)
    out = tmp_path / "map.csv"
    line = refusal(lambda: leg_map.main(["--out", str(out)]), capsys)
    assert line.startswith("scripts/tabulate_leg: ")
    assert not out.exists()


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (
            ["walk", "fly"],
            "argument STAGE: 'fly': expected one of forward, turn, steering, identify",
        ),
        (["stand"], "gait 'stand' is a posture, not a stride"),
        (["trot"], "no gait 'trot' (known: "),
        (["walk", "--friction", "-1"], "scripts/tune: friction[0] = -1.0: outside [0.01, 2]"),
        (["walk", "--seed", "0"], "argument --seed: 0 is below 1"),
    ],
)
def test_a_search_that_cannot_be_is_refused(tmp_path, capsys, arguments, reason):
    line = refusal(lambda: tune.main([*arguments, "--out", str(tmp_path / "gait.yaml")]), capsys)
    assert line.startswith("scripts/tune: ")
    assert reason in line
    assert not (tmp_path / "gait.yaml").exists()


def test_a_constraint_map_in_an_unknown_format_is_refused(capsys):
    line = refusal(lambda: constraint_map.main([str(WALK), "--out", "map.foo"]), capsys)
    assert line.endswith("--out map.foo: the name of a picture ends in .png")


def test_results_of_a_benchmark_into_a_file_are_refused(tmp_path, capsys):
    (tmp_path / "tiny").mkdir()
    source = '"""Tiny."""\n\ndef run(quick, out, progress):\n    return [], []\n'
    (tmp_path / "tiny" / "benchmark.py").write_text(source)
    (tmp_path / "file").write_text("")
    place = ["--benchmarks", str(tmp_path), "--out", str(tmp_path / "file")]
    line = refusal(lambda: command_line.main(["tiny", *place]), capsys)
    assert line == f"scripts/bench: --out {tmp_path / 'file'}: File exists"


def test_a_bag_with_a_name_too_long_is_refused(capsys):
    line = refusal(lambda: run.parse(["--bag", "x" * 300], read_graph()), capsys)
    assert line == "scripts/run: bag: File name too long"


def test_a_replay_whose_output_cannot_be_written_says_so():
    command = [sys.executable, "-m", "slot_lab.bags.check_bag", str(WALK)]
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, check=False)
    assert ended.returncode == 2
    assert ended.stderr == "scripts/replay: output: No space left on device\n"


@pytest.mark.parametrize("text", ["", "[1]\n", "horizon\n"])
def test_a_profile_of_the_mpc_that_is_no_mapping_is_refused(tmp_path, monkeypatch, text):
    shipped = Path(__file__).parents[1] / "config" / "mpc.yaml"
    (tmp_path / "mpc").mkdir()
    (tmp_path / "mpc.yaml").write_text(shipped.read_text())
    (tmp_path / "mpc" / "own.yaml").write_text(text)
    monkeypatch.setenv("SLOT_CONFIG", str(tmp_path))
    with pytest.raises(ConfigError, match=r"mpc/own\.yaml: expected a mapping of dotted names"):
        read_mpc("own")
