"""The frame of the benchmarks: what runs, on what, and how it is written down.

A benchmark is a module `scripts/benchmarks/NAME/benchmark.py`. The first line of its docstring says
what it measures; it has a function

    run(quick: bool, out: Path, progress: Callable[[str], None]) -> tuple[list[Row], list[Check]]

It may have options of its own on the command line: a function

    options(parser: argparse.ArgumentParser) -> None

adds them, each with a default, and `run` takes their values by name beside the rest.

A row is a mapping of names to plain values; files beside the result go to `out`. Whether the checks
hold is what a benchmark finds out, so it does not change the exit code.

Its parts are the files beside it, imported as `benchmarks.NAME.PART`. Packages that nothing
else needs it names in `REQUIRES`, one line at its top level; scripts/setup --bench installs them.
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
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

Row = Mapping[str, Any]

ROOT = Path(os.environ.get("SLOT_ROOT") or Path(__file__).resolve().parents[2])
UNKNOWN_NAME = 2  # exit code
INTERRUPTED = 130


class BenchmarkError(ValueError):
    """A benchmark that cannot be run; one line."""


@dataclass(frozen=True)
class Check:
    """A figure held against its goal."""

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
    """Median CPU time of `call`, after one call to warm up; each repeat times `calls` of them.

    CPU time and the median, because other processes share the machine.
    """
    call()
    times = []
    for _ in range(repeats):
        start = clock()
        for _ in range(calls):
            call()
        times.append((clock() - start) / calls)
    return CpuTime(statistics.median(times), min(times), max(times), repeats)


def known(directory: Path) -> dict[str, Path]:
    """The benchmarks in a directory by name."""
    return {path.parent.name: path for path in sorted(directory.glob("*/benchmark.py"))}


def run(
    name: str,
    directory: Path,
    quick: bool,
    out: Path,
    progress: Callable[[str], None],
    **chosen: Any,
) -> Path:
    """Run a benchmark and write `out/NAME.json`; returns its path.

    `chosen` are the values of its own options, by name. Raises BenchmarkError for an unknown name,
    a module without `run`, and as the benchmark does.
    """
    module = load(name, directory)
    out.mkdir(parents=True, exist_ok=True)
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
    """The module of a benchmark; raises BenchmarkError."""
    benchmarks = known(directory)
    if name not in benchmarks:
        raise BenchmarkError(f"no benchmark {name!r} (known: {', '.join(benchmarks) or 'none'})")
    spec = importlib.util.spec_from_file_location(f"slot_benchmark_{name}", benchmarks[name])
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look up their annotations
    spec.loader.exec_module(module)
    _need(name, getattr(module, "REQUIRES", ()))
    if not callable(getattr(module, "run", None)):
        raise BenchmarkError(f"benchmark {name}: has no function run(quick, out, progress)")
    return module


def _need(name: str, packages: Sequence[str]) -> None:
    """Raise BenchmarkError where a package is not installed: no peer is left out in silence."""
    missing = [package for package in packages if importlib.util.find_spec(package) is None]
    if missing:
        raise BenchmarkError(
            f"benchmark {name}: needs {', '.join(missing)}; run scripts/setup --bench"
        )


def revision(root: Path) -> dict[str, Any]:
    """Commit of the work tree and whether it has changes that are not committed; None: no git."""
    commit = _git(root, "rev-parse", "HEAD")
    changes = _git(root, "status", "--porcelain")
    return {
        "commit": commit,
        "describe": _git(root, "describe", "--always", "--tags"),
        "dirty": None if changes is None else bool(changes),
    }


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    return {
        "cpu": _cpu_model(),
        "architecture": platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": np.__version__,
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/bench`; returns the exit code."""
    parser = _parser()
    common, _ = _parser(add_help=False).parse_known_args(arguments)
    try:
        own = _add_own(parser, common)
    except BenchmarkError as error:
        print(f"scripts/bench: {error}", file=sys.stderr)
        return UNKNOWN_NAME
    options = parser.parse_args(arguments)
    if options.list:
        _list(options.benchmarks)
        return 0
    if options.name is None:
        parser.error(f"which one? (known: {', '.join(known(options.benchmarks)) or 'none'})")
    out = options.out or Path("results") / options.name
    chosen = {name: getattr(options, name) for name in own}
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        path = run(options.name, options.benchmarks, options.quick, out, _say, **chosen)
    except BenchmarkError as error:
        print(f"scripts/bench: {error}", file=sys.stderr)
        return UNKNOWN_NAME
    except KeyboardInterrupt:
        print("scripts/bench: interrupted", file=sys.stderr)
        return INTERRUPTED
    for line in check_lines(json.loads(path.read_text())["checks"]):
        print(line)
    print(path)
    return 0


def check_lines(checks: Sequence[Mapping[str, Any]]) -> list[str]:
    """Aligned lines `holds  name  value unit  (goal)`."""
    width = max((len(check["name"]) for check in checks), default=0)
    return [
        f"{'holds' if c['holds'] else 'MISSED':<7} {c['name']:<{width}}  "
        f"{'-' if c['value'] is None else format(c['value'], '.4g')} {c['unit']} (goal {c['goal']})"
        for c in checks
    ]


def _add_own(parser: argparse.ArgumentParser, common: argparse.Namespace) -> list[str]:
    """Add the options of the benchmark that is named, if any; their names."""
    if common.name is None or common.list:
        return []
    add = getattr(load(common.name, common.benchmarks), "options", None)
    if add is None:
        return []
    add(parser)
    return sorted(vars(parser.parse_args([common.name])).keys() - vars(common).keys())


def _parser(add_help: bool = True) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="scripts/bench",
        description="Runs a benchmark and writes DIR/NAME.json.",
        epilog="NAME --help also names the options of that benchmark.",
        add_help=add_help,
    )
    parser.add_argument("name", nargs="?", metavar="NAME", help="benchmark, see --list")
    parser.add_argument("--quick", action="store_true", help="fewer repeats, rougher figures")
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: results/NAME")
    parser.add_argument("--list", action="store_true", help="list the benchmarks")
    parser.add_argument(
        "--benchmarks",
        type=Path,
        metavar="DIR",
        default=ROOT / "scripts" / "benchmarks",
        help="where the benchmarks are (default: scripts/benchmarks)",
    )
    return parser


def _list(directory: Path) -> None:
    for name, path in known(directory).items():
        print(f"{name:<16}{_first_line(path)}")


def _first_line(path: Path) -> str:
    """First line of a module's docstring, without importing the module."""
    doc = ast.get_docstring(ast.parse(path.read_text())) or ""
    return doc.partition("\n")[0]


def _say(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _plain(value: Any) -> Any:
    """`value` as JSON can hold it: NumPy's numbers as Python's, NaN and infinity as null."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _git(root: Path, *arguments: str) -> str | None:
    command = ["git", "-C", str(root), *arguments]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None


def _cpu_model() -> str:
    """Name of the processor, as Linux has it (some ARM kernels do not)."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return models[0] if models else platform.processor()


if __name__ == "__main__":
    sys.exit(main())
