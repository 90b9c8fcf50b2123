"""Runs a benchmark and writes its result: rows, checks, revision of the code and the machine.

A benchmark is a module `scripts/benchmarks/NAME/benchmark.py`. The first line of its docstring says
what it measures; it has a function

    run(quick: bool, out: Path, progress: Progress) -> Outcome

It may have command line options: a function

    options(parser: argparse.ArgumentParser) -> None

in a file `options.py` beside it, which imports Python's standard library alone, adds them, each
with a default, and `run` takes their values as keyword arguments.

A row is a mapping of names to plain values; other files, such as plots, go to `out`. Plots are
drawn from the rows and from courses over time in `out/courses.npz`, and so scripts/docs --pictures draws
them again. A measurement that may fail, such as a run of the graph, is made by `Attempts`. A check
that does not hold is a result, so it does not change the exit code. A time is the processor's as
much as the code's, so its check is on the ratio to a peer measured in the same run; the goals of
the graph and the servos, which are times, are checks beside that.

The parts of a benchmark are the files beside it, imported as `benchmarks.NAME.PART`. Packages that
only benchmarks need are named in `REQUIRES`, one line at the top level of the module;
scripts/setup --bench installs them.
"""

from __future__ import annotations

import argparse
import ast
import dataclasses
import importlib.util
import json
import math
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from slot_core.refusal import InputError, quoted

T = TypeVar("T")
Row = Mapping[str, Any]
Progress = Callable[[str], None]
Outcome = tuple[Sequence[Row], Sequence["Check"]]  # of a benchmark

COURSES = "courses.npz"
ROOT = Path(os.environ.get("SLOT_ROOT") or Path(__file__).resolve().parents[2])


class BenchmarkError(InputError):
    """A benchmark that cannot be run; the message is one line."""


@dataclass(frozen=True)
class Check:
    """A value compared with its goal."""

    name: str
    value: float
    unit: str
    goal: str  # for example "<= 33.3"
    holds: bool


def at_most(name: str, value: float, goal: float, unit: str = "") -> Check:
    """The check value <= goal; NaN does not hold."""
    return Check(name, value, unit, f"<= {goal:g}", bool(value <= goal))


def at_least(name: str, value: float, goal: float, unit: str = "") -> Check:
    """The check value >= goal; NaN does not hold."""
    return Check(name, value, unit, f">= {goal:g}", bool(value >= goal))


class Attempts:
    """Measurements that may fail: each that does is a row and a missed check, the others go on."""

    def __init__(self) -> None:
        self.rows: list[Row] = []
        self.checks: list[Check] = []

    def run(self, name: str, call: Callable[..., T], *arguments: Any) -> T | None:
        """Result of the call; None if it raises BenchmarkError."""
        try:
            return call(*arguments)
        except BenchmarkError as error:
            self.rows.append({"kind": "failed", "what": name, "reason": str(error)})
            self.checks.append(Check(name, math.nan, "", "measured", False))
            return None


@dataclass(frozen=True)
class CpuTime:
    """CPU time of one call, s, over repeats."""

    median: float
    least: float
    largest: float
    repeats: int


def cpu_time(
    call: Callable[[], Any],
    repeats: int,
    calls: int = 1,
    clock: Callable[[], float] = time.process_time,
) -> CpuTime:
    """CPU time of `call` after one call to warm up; each repeat is the mean over `calls` calls.

    CPU time and its median, because other processes share the machine.
    """
    call()
    times = []
    for _ in range(repeats):
        start = clock()
        for _ in range(calls):
            call()
        times.append((clock() - start) / calls)
    return CpuTime(statistics.median(times), min(times), max(times), repeats)


def timed(call: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """Result of a call, and its CPU time, s."""
    start = time.process_time()
    result = call(*arguments)
    return result, time.process_time() - start


def cpu_ratio(
    call: Callable[[], Any],
    reference: Callable[[], Any],
    repeats: int,
    clock: Callable[[], float] = time.process_time,
) -> float:
    """CPU time of `call` over that of `reference`: the median over repeats, called in turn.

    Both run at the same speed of the machine, whatever that is.
    """
    return statistics.median(
        cpu_time(call, 1, clock=clock).median
        / cpu_time(reference, 1, clock=clock).median
        for _ in range(repeats)
    )


def mark_front(
    rows: Sequence[dict[str, Any]], cost: str, error: Callable[[Row], float]
) -> None:
    """Mark the Pareto front: rows for which no other is both cheaper and more exact.

    A row without a finite error is not on it.
    """
    for row in rows:
        row["front"] = error(row) < math.inf and not any(
            other[cost] < row[cost] and error(other) < error(row) for other in rows
        )


def known(directory: Path) -> dict[str, Path]:
    """The benchmarks in a directory by name."""
    return {path.parent.name: path for path in sorted(directory.glob("*/benchmark.py"))}


def about(benchmark: Path) -> str:
    """Subject of a benchmark: the first line of its docstring; the module is not imported."""
    return (ast.get_docstring(ast.parse(benchmark.read_text())) or "").partition("\n")[
        0
    ]


def run(
    name: str,
    directory: Path,
    quick: bool,
    out: Path,
    progress: Progress,
    **chosen: Any,
) -> Path:
    """Run a benchmark and write `out/NAME.json`; returns its path.

    `chosen` are the values of the benchmark's options, by name. Raises BenchmarkError for an
    unknown name, a missing package and a module without `run`, and what the benchmark raises.
    """
    module = load(name, directory)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchmarkError(f"--out {out}: {error.strerror}") from None
    rows, checks = module.run(quick, out, progress, **chosen)
    result = {
        "name": name,
        "quick": quick,
        "options": chosen,
        "revision": revision(ROOT),
        "machine": machine(),
        "rows": [dict(row) for row in rows],
        "checks": [dataclasses.asdict(check) for check in checks],
    }
    path = out / f"{name}.json"
    path.write_text(json.dumps(_plain(result), indent=2, allow_nan=False) + "\n")
    return path


def load(name: str, directory: Path) -> ModuleType:
    """Import the module of a benchmark; raises BenchmarkError."""
    module = _imported(f"slot_benchmark_{name}", _find(name, directory))
    packages = getattr(module, "REQUIRES", ())
    missing = [
        package for package in packages if importlib.util.find_spec(package) is None
    ]
    if missing:  # no peer is left out silently
        raise BenchmarkError(
            f"benchmark {name}: needs {', '.join(missing)}; run scripts/setup --bench"
        )
    if not callable(getattr(module, "run", None)):
        raise BenchmarkError(
            f"benchmark {name}: has no function run(quick, out, progress)"
        )
    return module


def add_options(parser: argparse.ArgumentParser, name: str, directory: Path) -> None:
    """Add the options of a benchmark, if it has any; raises BenchmarkError for an unknown name."""
    path = _find(name, directory).with_name("options.py")
    if path.exists():
        _imported(f"slot_benchmark_{name}_options", path).options(parser)


def _find(name: str, directory: Path) -> Path:
    benchmarks = known(directory)
    if name not in benchmarks:
        there = ", ".join(benchmarks) or "none"
        raise BenchmarkError(f"no benchmark {quoted(name)} (known: {there})")
    return benchmarks[name]


def _imported(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look up their annotations there
    spec.loader.exec_module(module)
    return module


def revision(root: Path) -> dict[str, Any]:
    """Commit of the work tree, and whether it has uncommitted changes; None without git."""
    commit = _git(root, "rev-parse", "HEAD")
    changes = _git(root, "status", "--porcelain")
    return {
        "commit": commit,
        "describe": _git(root, "describe", "--always", "--tags"),
        "dirty": None if changes is None else bool(changes),
    }


def machine() -> dict[str, Any]:
    """Processor, system and versions on which the benchmark ran."""
    return {
        "cpu": _cpu_model(),
        "architecture": platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": version("numpy"),
    }


def _plain(value: Any) -> Any:
    """`value` as JSON: NumPy's numbers as Python's, NaN and infinity as null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # an array or number of NumPy
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _git(root: Path, *arguments: str) -> str | None:
    command = ["git", "-C", str(root), *arguments]
    try:
        return subprocess.run(
            command, capture_output=True, text=True, check=True
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def _cpu_model() -> str:
    """Name of the processor from Linux (some ARM kernels give none)."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    models = [
        line.partition(":")[2].strip()
        for line in lines
        if line.startswith("model name")
    ]
    return models[0] if models else platform.processor()
