"""Benchmarks can be imported; a tiny one runs and leaves its result."""

import importlib
import json
import math
import sys
from types import SimpleNamespace

import pytest

from benchmarks import harness
from benchmarks.__main__ import main


def run(quick, out, progress):
    nothing = harness.at_least("nothing", math.nan, 1.0, "ms")
    return [{"n": 1}], [harness.at_most("rows", 4, 3), nothing]


def test_a_benchmark_leaves_its_result_and_one_that_is_not_there_is_refused(
    tmp_path, monkeypatch, capsys, refusal
):
    folder, out = tmp_path / "tiny", tmp_path / "out" / "deep"
    folder.mkdir()
    (folder / "benchmark.py").write_text('"""Counts."""')
    monkeypatch.setattr(harness, "BENCHMARKS", tmp_path)
    module = "benchmarks.tiny.benchmark"
    monkeypatch.setitem(sys.modules, module, SimpleNamespace(run=run))
    assert main(["tiny", "--out", str(out), "--quick"]) == 0
    result = json.loads((out / "tiny.json").read_text())
    assert (result["quick"], result["rows"]) == (True, [{"n": 1}])
    values = [check["value"] for check in result["checks"]]
    assert values == [4, None]
    assert "MISSED  rows" in capsys.readouterr().out
    line = "scripts/bench: no benchmark 'tinny' (known: tiny)"
    assert refusal(main, "tinny", "--out", out) == line


@pytest.mark.parametrize("name", harness.known())
def test_every_benchmark_can_be_imported(name):
    try:
        module = importlib.import_module(f"benchmarks.{name}.benchmark")
    except ModuleNotFoundError as error:
        pytest.skip(f"needs {error.name}: scripts/setup --bench")
    assert callable(module.run)
