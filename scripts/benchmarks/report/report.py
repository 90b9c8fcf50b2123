"""Makes one page in Markdown of what scripts/bench, scripts/run and scripts/validate wrote.

The page links to the pictures beside the results. Each figure stands with the command, revision and
parameters that made it, and beside the paper's where that has one. The page names every result that
is missing, with the command that makes it.
"""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.harness import ROOT, about, known
from benchmarks.report.results import (
    ReportError,
    commands,
    read_benchmark,
    read_run,
)
from slot_core.command_line import CommandParser, refuse

if TYPE_CHECKING:
    from benchmarks.report.page import Contents

CANNOT_REPORT = 2  # exit code
BENCHMARKS = ROOT / "scripts" / "benchmarks"
CAPTIONS = {
    "rod": {"rod.png": "speed against error of the public rod, MuJoCo and PyElastica"},
    "robot": {
        "robot.png": "speed against error of the whole robot",
        "other_engine.png": "speeds of the gaits here and in MuJoCo",
    },
    "mpc": {"mpc.png": "speed against error of the solvers, and time over the horizon"},
    "estimation": {
        "estimation.png": "error of the state over the delay of the odometry"
    },
    "locomotion": {
        "table.png": "every row in units of its goal",
        "velocity.png": "commanded and achieved velocity in all directions",
        "top.png": "square and 60 deg path from above",
        "margins.png": "the walk over friction and the servos' supply voltage",
        "gaits.png": "every gait in stills: postures, then strides over their phase",
    },
    "perturbations": {
        "perturbations.png": "maximum cost beside the paper's, motion of the robot",
    },
    "graph": {"graph.png": "latency, CPU time and memory of the nodes"},
    "servo": {"servo_step.png": "a step of an emulated servo"},
}
"""Images of the benchmarks with their captions, in the order of the report."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/report`; ends with exit code 2 and one line on a bad input."""
    parser = CommandParser(prog="scripts/report", description=__doc__)
    results, out = Path("results"), Path("results", "report.md")
    parser.add_argument(
        "--results",
        type=Path,
        metavar="DIR",
        default=results,
        help=f"default: {results}",
    )
    parser.add_argument(
        "--out", type=Path, metavar="FILE", default=out, help=f"default: {out}"
    )
    options = parser.parse_args(arguments)
    from benchmarks.report.page import render  # noqa: PLC0415 - heavy
    from slot_core.recording.origin import revision  # noqa: PLC0415

    try:
        if options.out.suffix != ".md":
            raise ReportError(f"--out {options.out}: expected a name that ends in .md")
        contents = read_contents(options.results)
        _write(options.out, render(contents, revision(), options.out.parent))
    except ReportError as error:
        refuse(parser.prog, error)
        return CANNOT_REPORT
    print(options.out)
    return 0


def read_contents(directory: Path) -> Contents:
    """All that a report shows of the results in `directory`; raises ReportError."""
    from benchmarks.report.page import Contents  # noqa: PLC0415 - heavy
    from benchmarks.report.paper_figures import RUNS  # noqa: PLC0415 - heavy

    if not directory.is_dir():
        raise ReportError(
            f"--results {directory}: not a directory; scripts/bench NAME makes one"
        )
    found = known(BENCHMARKS)
    names = [
        *(name for name in CAPTIONS if name in found),
        *sorted(found.keys() - CAPTIONS.keys()),
    ]
    benchmarks = {
        name: (
            about(found[name]),
            read_benchmark(directory, name, CAPTIONS.get(name, {})),
        )
        for name in names
    }
    return Contents(
        benchmarks=benchmarks,
        runs={run.folder: (run.title, read_run(directory, run)) for run in RUNS},
        commands={
            name: [shlex.join(["scripts/bench", name, "--out", str(directory / name)])]
            for name in names
        }
        | {run.folder: commands(directory, run) for run in RUNS},
    )


def _write(path: Path, text: str) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8", errors="replace")
    except OSError as error:
        raise ReportError(f"--out {path}: {error.strerror}") from None


if __name__ == "__main__":
    sys.exit(main())
