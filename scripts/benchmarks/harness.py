"""Runs a benchmark and writes its result: rows, checks, revision of the code and the machine.

A benchmark is a module `scripts/benchmarks/NAME/benchmark.py`. The first line of its docstring says
what it measures; it has a function

    run(quick: bool, out: Path, progress: Progress) -> Outcome

A row is a mapping of names to plain values; other files, such as plots, go to `out`. Plots are
drawn from the rows and from courses over time in `out/courses.npz`, and so scripts/docs --pictures draws
them again. A measurement that may fail, such as a run of the graph, is made by `Attempts`. A check
that does not hold is a result, so it does not change the exit code. A time is the processor's as
much as the code's, so its check is on the ratio to a peer measured in the same run; the goals of
the graph and the servos, which are times, are checks beside that.

Other files of a benchmark stand beside it, imported as `benchmarks.NAME.PART`. Packages that only
benchmarks need are named in `REQUIRES`, one line at the top level of the module, for which
scripts/bench runs scripts/setup --bench.
"""

import ast
import dataclasses
import importlib
import json
import math
import multiprocessing
import os
import platform
import re
import statistics
import subprocess
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypeVar

from slot_core.command_line import missing
from slot_core.refusal import InputError, quoted

T, S = TypeVar("T"), TypeVar("S")
Row = Mapping[str, Any]
Progress = Callable[[str], None]

COURSES = "courses.npz"
REPORTS = 20  # lines of progress over a benchmark's runs
ROOT = Path(os.environ.get("SLOT_ROOT") or Path(__file__).resolve().parents[2])
BENCHMARKS = ROOT / "scripts" / "benchmarks"


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


Outcome = tuple[Sequence[Row], Sequence[Check]]  # of a benchmark


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

    def run(
        self, name: str, call: Callable[..., T], *arguments: Any
    ) -> T | None:
        """Result of the call; None if it raises BenchmarkError."""
        try:
            return call(*arguments)
        except BenchmarkError as error:
            self.rows.append(
                {"kind": "failed", "what": name, "reason": str(error)}
            )
            self.checks.append(Check(name, math.nan, "", "measured", False))
            return None


def timed(call: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """Result of a call, and its CPU time, s."""
    start = time.process_time()
    result = call(*arguments)
    return result, time.process_time() - start


def cpu_time(call: Callable[[], Any], repeats: int, calls: int = 1) -> float:
    """CPU time of `call`, s, after one call to warm up: the median of means over `calls` calls.

    CPU time and its median, because other processes share the machine.
    """
    call()
    times = [
        timed(lambda: [call() for _ in range(calls)])[1] for _ in range(repeats)
    ]
    return statistics.median(times) / calls


def cpu_ratio(
    call: Callable[[], Any], reference: Callable[[], Any], repeats: int
) -> float:
    """Ratio of the CPU times of `call` and `reference`: the median over repeats, called in turn.

    Both run at the same speed of the machine, whatever that is.
    """
    return statistics.median(
        cpu_time(call, 1) / cpu_time(reference, 1) for _ in range(repeats)
    )


def in_processes(
    call: Callable[[S], T], jobs: Sequence[S], progress: Progress
) -> Iterator[T]:
    """Results of the jobs in any order, from a process on each core.

    The last job is done before the others start: it compiles the kernels once.
    """
    if jobs:
        yield call(jobs[-1])
    workers = len(os.sched_getaffinity(0))
    with multiprocessing.get_context("spawn").Pool(workers) as pool:
        results = pool.imap_unordered(call, jobs[:-1])
        for count, result in enumerate(results, 2):
            if count % max(1, len(jobs) // REPORTS) == 0:
                progress(f"{count} of {len(jobs)} runs")
            yield result


def resumed(
    call: Callable[[S], tuple[S, T]],
    jobs: Sequence[S],
    path: Path,
    progress: Progress,
    read: Callable[[Any], T],
) -> dict[S, T]:
    """Results of all jobs; `call` returns a job and its result.

    Those that an interrupted benchmark has left in the file are taken, if the revision is the same
    and committed; `read` makes a result from its JSON.
    """
    now = revision(ROOT)
    lines = path.read_text().splitlines(True) if path.exists() else []
    before = {
        job: result
        for job, made_at, result in map(
            json.loads, (line for line in lines if line.endswith("\n"))
        )
        if made_at == now and not now["dirty"]
    }
    found = {
        job: read(before[repr(job)]) for job in jobs if repr(job) in before
    }
    with path.open("w") as file:
        file.writelines(
            f"{json.dumps([job, now, before[job]])}\n" for job in before
        )
        for job, result in in_processes(
            call, [job for job in jobs if job not in found], progress
        ):
            found[job] = result
            print(
                json.dumps(
                    [repr(job), now, result],
                    default=lambda x: (
                        vars(x) if dataclasses.is_dataclass(x) else x.tolist()
                    ),
                ),
                file=file,
                flush=True,
            )
    return found


def mark_front(
    rows: Sequence[dict[str, Any]], cost: str, error: Callable[[Row], float]
) -> None:
    """Mark the Pareto front: rows for which no other is both cheaper and more exact.

    A row without a finite error is not on it.
    """
    for row in rows:
        row["front"] = error(row) < math.inf and not any(
            other[cost] < row[cost] and error(other) < error(row)
            for other in rows
        )


def known() -> dict[str, str]:
    """Subjects of the benchmarks by name: the first lines of their docstrings, not imported."""
    texts = {
        p.parent.name: p.read_text() for p in BENCHMARKS.glob("*/benchmark.py")
    }
    return {
        name: (ast.get_docstring(ast.parse(text)) or "").partition("\n")[0]
        for name, text in sorted(texts.items())
    }


def run(name: str, quick: bool, out: Path, progress: Progress) -> Path:
    """Run a benchmark and write `out/NAME.json`; returns its path.

    Raises BenchmarkError for an unknown name and a missing package, and what the benchmark raises.
    """
    if name not in known():
        raise BenchmarkError(
            f"no benchmark {quoted(name)} (known: {', '.join(known())})"
        )
    try:
        module = importlib.import_module(f"benchmarks.{name}.benchmark")
    except ModuleNotFoundError as error:  # no peer is left out silently
        raise BenchmarkError(
            f"benchmark {name}: {missing(error.name)}"
        ) from None
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BenchmarkError(f"--out {out}: {error.strerror}") from None
    rows, checks = module.run(quick, out, progress)
    result = {
        "name": name,
        "quick": quick,
        "revision": revision(ROOT),
        "machine": machine(),
        "rows": [dict(row) for row in rows],
        "checks": [dataclasses.asdict(check) for check in checks],
    }
    path = out / f"{name}.json"
    path.write_text(
        json.dumps(as_json(result), indent=2, allow_nan=False) + "\n"
    )
    return path


def revision(root: Path) -> dict[str, Any]:
    """Commit of the work tree, and whether it has uncommitted changes; None without git."""
    changes = _git(root, "status", "--porcelain")
    return {
        "commit": _git(root, "rev-parse", "HEAD"),
        "describe": _git(root, "describe", "--always", "--tags"),
        "dirty": None if changes is None else bool(changes),
    }


def machine() -> dict[str, Any]:
    """Processor, system and versions on which the benchmark ran."""
    info = Path("/proc/cpuinfo")  # names the processor, but on some ARM kernels
    text = info.read_text() if info.exists() else ""
    models = re.findall(r"^model name\s*: (.*)", text, re.M)
    return {
        "cpu": next(iter(models), platform.processor()),
        "architecture": platform.machine(),
        "cores": len(os.sched_getaffinity(0)),
        "system": platform.system(),
        "python": platform.python_version(),
        "numpy": version("numpy"),
    }


def as_json(value: Any) -> Any:
    """`value` as JSON: NumPy's numbers as Python's, NaN and infinity as null."""
    if isinstance(value, Mapping):
        return {str(key): as_json(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # an array or number of NumPy
        value = value.tolist()
    if isinstance(value, (list, tuple)):
        return [as_json(item) for item in value]
    return (
        None if isinstance(value, float) and not math.isfinite(value) else value
    )


def _git(root: Path, *arguments: str) -> str | None:
    try:
        return subprocess.run(
            ["git", "-C", str(root), *arguments],
            capture_output=True,
            text=True,
            check=True,
        ).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
