"""Harness and command line of the benchmarks, with tiny benchmarks."""

import importlib
import json
import platform
import sys
import types

import numpy as np
import pytest

from benchmarks import harness
from benchmarks.__main__ import main


def run(quick, out, progress):
    rows = [
        {"n": np.int64(n), "root": np.sqrt(n)} for n in range(2 if quick else 4)
    ]
    progress("half way")
    (out / "tiny.txt").write_text("beside")
    nothing = harness.at_least("nothing", float("nan"), 1.0, "ms")
    return rows, [harness.at_most("rows", len(rows), 3), nothing]


@pytest.fixture
def places(tmp_path, monkeypatch):
    """Directory of a benchmark `tiny` and one whose peer is missing, and where results go."""
    for name, text in {"tiny": "", "rival": "import no_such_peer"}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "benchmark.py").write_text(
            f'"""Counts.\n\nMore."""\n{text}'
        )
    monkeypatch.setattr(harness, "BENCHMARKS", tmp_path)
    package = types.ModuleType("benchmarks.rival")
    package.__path__ = [str(tmp_path / "rival")]
    monkeypatch.setitem(sys.modules, "benchmarks.rival", package)
    tiny = types.SimpleNamespace(run=run)
    monkeypatch.setitem(sys.modules, "benchmarks.tiny.benchmark", tiny)
    return tmp_path / "out" / "deep"


def test_result_holds_rows_checks_revision_machine_and_whether_it_was_quick(
    places, capsys
):
    assert main(["tiny", "--out", str(places)]) == 0
    result = json.loads((places / "tiny.json").read_text())
    assert [row["n"] for row in result["rows"]] == [0, 1, 2, 3]
    assert result["rows"][2]["root"] == pytest.approx(2**0.5)
    missed = {"unit": "ms", "goal": ">= 1", "holds": False}
    assert result["checks"] == [
        {
            "name": "rows",
            "value": 4,
            "unit": "",
            "goal": "<= 3",
            "holds": False,
        },
        {"name": "nothing", "value": None, **missed},
    ]
    assert set(result["revision"]) == {"commit", "describe", "dirty"}
    assert result["machine"]["python"] == platform.python_version()
    assert result["machine"]["cpu"]
    assert (places / "tiny.txt").read_text() == "beside"
    output = capsys.readouterr()
    assert "MISSED  rows" in output.out
    assert output.err == "half way\n"
    assert main(["tiny", "--out", str(places), "--quick"]) == 0
    result = json.loads((places / "tiny.json").read_text())
    assert (result["quick"], len(result["rows"])) == (True, 2)
    assert main(["--list"]) == 0
    assert "tiny            Counts.\n" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("tinny", "no benchmark 'tinny' (known: rival, tiny)"),
        (
            "rival",
            "benchmark rival: needs no_such_peer; run scripts/setup --bench",
        ),
    ],
)
def test_a_benchmark_that_cannot_run_is_refused_in_one_line(
    places, refusal, name, reason
):
    assert refusal(main, name, "--out", places) == f"scripts/bench: {reason}"
    assert not places.exists()


@pytest.mark.parametrize("name", harness.known())
def test_every_benchmark_can_be_imported(name):
    try:
        module = importlib.import_module(f"benchmarks.{name}.benchmark")
    except ModuleNotFoundError as error:
        pytest.skip(f"needs {error.name}: scripts/setup --bench")
    assert callable(module.run)
