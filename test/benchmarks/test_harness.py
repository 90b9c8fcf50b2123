"""Harness and command line of the benchmarks, with tiny benchmarks."""

import argparse
import inspect
import json
import os
import platform
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from benchmarks import harness
from benchmarks.__main__ import main
from benchmarks.harness import Attempts, BenchmarkError, at_least, at_most, cpu_time

ROOT = Path(__file__).resolve().parents[2]

TINY = '''"""Counts to the number of its rows.

More words.
"""
from benchmarks.harness import at_least, at_most
import numpy as np

def run(quick, out, progress):
    rows = [{"n": np.int64(n), "root": np.sqrt(n)} for n in range(2 if quick else 4)]
    progress("half way")
    (out / "tiny.txt").write_text("beside")
    return rows, [at_most("rows", len(rows), 3), at_least("nothing", float("nan"), 1.0, "ms")]
'''


def write_benchmark(directory, name, text):
    (directory / name).mkdir(exist_ok=True)
    (directory / name / "benchmark.py").write_text(text)


@pytest.fixture
def places(tmp_path):
    directory = tmp_path / "benchmarks"
    directory.mkdir()
    write_benchmark(directory, "tiny", TINY)
    return directory, tmp_path / "out" / "deep"


def bench(places, *arguments):
    directory, out = places
    return main([*arguments, "--benchmarks", str(directory), "--out", str(out)])


def test_result_holds_rows_checks_revision_machine_and_whether_it_was_quick(
    places, capsys
):
    assert bench(places, "tiny") == 0
    result = json.loads((places[1] / "tiny.json").read_text())
    assert [row["n"] for row in result["rows"]] == [0, 1, 2, 3]
    assert result["rows"][2]["root"] == pytest.approx(2**0.5)
    assert result["checks"] == [
        {"name": "rows", "value": 4, "unit": "", "goal": "<= 3", "holds": False},
        {
            "name": "nothing",
            "value": None,
            "unit": "ms",
            "goal": ">= 1",
            "holds": False,
        },
    ]
    assert set(result["revision"]) == {"commit", "describe", "dirty"}
    assert result["machine"]["python"] == platform.python_version()
    assert result["machine"]["numpy"] == np.__version__
    assert result["machine"]["cores"] >= 1
    assert result["machine"]["cpu"]
    assert (places[1] / "tiny.txt").read_text() == "beside"
    output = capsys.readouterr()
    assert "MISSED  rows" in output.out
    assert output.err == "half way\n"
    assert bench(places, "tiny", "--quick") == 0
    result = json.loads((places[1] / "tiny.json").read_text())
    assert (result["quick"], len(result["rows"])) == (True, 2)


@pytest.mark.parametrize(
    ("name", "source", "reason"),
    [
        ("tinny", None, "no benchmark 'tinny' (known: tiny)"),
        ("empty", '"""Nothing."""', "benchmark empty: has no function run"),
        (
            "rival",
            f'REQUIRES = ("json", "no_such_peer", "nor_this")\n{TINY}',
            "benchmark rival: needs no_such_peer, nor_this; run scripts/setup --bench",
        ),
    ],
)
def test_a_benchmark_that_cannot_run_is_refused_in_one_line(
    places, capsys, name, source, reason
):
    if source is not None:
        write_benchmark(places[0], name, source)
    assert bench(places, name) == 2
    [line] = capsys.readouterr().err.splitlines()
    assert line.startswith(f"scripts/bench: {reason}")
    assert not places[1].exists()


OPTIONS = """
def options(parser):
    parser.add_argument("--count", type=int, default=3)
"""
OWN = '''"""With options of its own."""

def run(quick, out, progress, *, count):
    return [{"count": count}], []
'''


@pytest.mark.parametrize(("given", "count"), [((), 3), (("--count", "5"), 5)])
def test_a_benchmark_gets_the_options_that_it_declares_and_no_others(
    places, given, count
):
    write_benchmark(places[0], "own", OWN)
    (places[0] / "own" / "options.py").write_text(OPTIONS)
    assert bench(places, "own", *given) == 0
    assert json.loads((places[1] / "own.json").read_text())["rows"] == [
        {"count": count}
    ]
    with pytest.raises(SystemExit):
        bench(places, "own", "--other", "5")


def test_checks_hold_up_to_their_goal():
    assert at_most("latency", 33.3, 33.3, "ms").holds
    assert not at_most("latency", 33.4, 33.3, "ms").holds
    assert at_least("speed", 0.05, 0.05, "m/s").holds
    assert not at_least("speed", 0.049, 0.05, "m/s").holds
    assert not at_most("unknown", float("nan"), 1.0).holds


def test_a_measurement_that_fails_is_a_row_and_a_missed_check_and_the_others_go_on():
    attempts = Attempts()

    def fail(number):
        raise BenchmarkError(f"the graph failed: {number}")

    assert attempts.run("first", fail, 1) is None
    assert attempts.run("second", abs, -2) == 2
    assert attempts.rows == [
        {"kind": "failed", "what": "first", "reason": "the graph failed: 1"}
    ]
    [check] = attempts.checks
    assert (check.name, check.holds) == ("first", False)


@pytest.mark.parametrize("name", harness.known(ROOT / "scripts/benchmarks"))
def test_every_benchmark_can_be_imported_with_its_options(name):
    directory, parser = ROOT / "scripts/benchmarks", argparse.ArgumentParser()
    harness.add_options(parser, name, directory)
    try:
        wanted = inspect.signature(harness.load(name, directory).run).parameters
    except BenchmarkError as error:
        pytest.skip(str(error))  # needs scripts/setup --bench
    assert set(vars(parser.parse_args([]))) == set(wanted) - {
        "quick",
        "out",
        "progress",
    }


def test_cpu_time_is_the_median_per_call_after_a_warm_up():
    ticks = iter(
        [0.0, 6.0, 10.0, 12.0, 20.0, 60.0]
    )  # repeats of 6, 2 and 40 s, two calls each
    calls = []
    figure = cpu_time(
        lambda: calls.append(None), repeats=3, calls=2, clock=lambda: next(ticks)
    )
    assert (figure.median, figure.least, figure.largest, figure.repeats) == (
        3.0,
        1.0,
        20.0,
        3,
    )
    assert len(calls) == 1 + 3 * 2


def git(directory, *arguments):
    identity = ["-c", "user.name=n", "-c", "user.email=n@example.com"]
    subprocess.run(
        ["git", "-C", directory, *identity, *arguments], check=True, capture_output=True
    )


def test_revision_distinguishes_a_changed_work_tree_from_a_clean_one(tmp_path):
    git(tmp_path, "init", "-q")
    (tmp_path / "file").write_text("one")
    git(tmp_path, "add", "file")
    git(tmp_path, "commit", "-q", "-m", "one")
    clean = harness.revision(tmp_path)
    assert (len(clean["commit"]), clean["dirty"]) == (40, False)
    assert clean["commit"].startswith(clean["describe"])
    (tmp_path / "file").write_text("two")
    assert harness.revision(tmp_path) == {**clean, "dirty": True}


def test_revision_outside_git_is_unknown(tmp_path, monkeypatch):
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    assert harness.revision(tmp_path) == {
        "commit": None,
        "describe": None,
        "dirty": None,
    }


@pytest.mark.parametrize("needs", [False, True])
def test_script_sets_up_sources_the_environment_and_passes_its_arguments_and_exit_code(
    tmp_path, needs
):
    scripts = tmp_path / "scripts"
    (scripts / "benchmarks/graph").mkdir(parents=True)
    (scripts / "benchmarks/graph/benchmark.py").write_text(
        'REQUIRES = ("peer",)\n' * needs
    )
    for name in ("bench", "help"):
        shutil.copy(ROOT / "scripts" / name, scripts)
    # The installation of the packages fails; the benchmark reports that, not the setup.
    setup = f"#!/bin/sh\necho setup $* >> {tmp_path}/order\n[ $# = 0 ]\n"
    (scripts / "setup").write_text(setup)
    python = 'python() { echo "python $*" >> "$root/order"; exit 7; }\n'
    (scripts / "env").write_text(
        f'echo env >> "$root/order"\nexec() {{ "$@"; }}\n{python}'
    )
    for name in ("bench", "setup"):
        (scripts / name).chmod(0o755)
    ended = subprocess.run(
        [scripts / "bench", "graph", "--quick"],
        cwd="/",
        check=False,
        env=dict(os.environ),
    )
    assert ended.returncode == 7
    order = (tmp_path / "order").read_text().splitlines()
    setups = ["setup", "setup --bench"] if needs else ["setup"]
    assert order == [*setups, "env", "python -m benchmarks graph --quick"]
