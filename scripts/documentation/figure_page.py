"""Writes the page of figures, slot_bringup/doc/figures.md, from the results of the benchmarks.

`scripts/docs --figures` reads results/NAME/NAME.json, which scripts/bench NAME writes. The section of
a benchmark that has no result stays as it is; without one the page says which command is missing.
"""

import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from benchmarks.harness import known
from documentation import DOC, ROOT
from documentation.markdown import plain, table
from documentation.pictures import PICTURES
from documentation.results import Result, number, read_result, write_page
from slot_core.command_line import command_parser

INTRODUCTION = """\
# Figures

[README](../../README.md) | previous: [The paper](paper.md)

Every figure here is measured: `scripts/bench NAME` runs a benchmark, and `scripts/docs --figures` writes its
section again. A quick run has fewer repeats and rougher figures. A check compares a figure with its goal;
a goal that is missed is in bold. Pictures are of the last full run.
"""
SHOWN: Mapping[str, Mapping[str, Sequence[str]]] = {
    "beside": {
        "beside": (
            "work",
            "unit",
            "before",
            "now",
            "now_over_before",
            "goal",
        )
    },
    "estimation": {
        "delay": ("method", "delay_ms", "position_mm", "velocity_mm_s"),
        "tracker": ("image_plane_mm", "depth_mm"),
        "cpu": ("sample_us", "plain_step_us"),
    },
    "graph": {
        "closed loop": ("cpu_s_per_s", "speed"),
        "lockstep": ("nodes", "speed"),
        "latency": ("nodes", "stage", "p50_ms", "p99_ms", "max_ms"),
        "node": ("nodes", "node", "cpu_percent", "pss_mb"),
        "share": (
            "nodes",
            "share",
            "late_percent",
            "p50_ms",
            "p99_ms",
            "mean_v_x",
            "slowest",
        ),
    },
    "held_out": {
        "": ("row", "unit", "goal", "rods", "mujoco", "mujoco, gait alone")
    },
    "learning": {
        "throughput": ("level", "step", "threads", "steps_per_s"),
        "level": ("level", "step", "friction", "mm_per_s", "error"),
        "peer": ("name", "speed"),
    },
    "legs": {
        "leg": (
            "leg",
            "wall_s",
            "cpu_s_per_core",
            "cruise_mm_s",
            "reached_mm_s",
            "tilt_deg",
            "height_mm",
            "falls",
        )
    },
    "locomotion": {
        "": (
            "row",
            "unit",
            "goal",
            "gait alone",
            "place",
            "learned",
            "default",
        ),
        "margin": (
            "voltage",
            "friction",
            "with",
            "speed",
            "aside",
            "tilt",
            "load",
        ),
        "ablation": ("part", "row", "unit", "with", "without"),
    },
    "mpc": {
        "solver": (
            "tolerance",
            "median_ms",
            "p99_ms",
            "error_max",
            "hard_error_max",
        ),
        "cvxpy": ("solver", "median_ms", "error_max"),
        "horizon": ("stages", "median_ms"),
    },
    "perturbations": {
        "case": ("study", "case", "max_cost", "paper_max_cost", "settling_s")
    },
    "robot": {
        "level": ("level", "nodes", "step", "error_mm", "us_per_ms"),
        "replay": ("gait", "friction", "own_v_x", "other_v_x", "goal"),
    },
    "servo": {
        "emulated cycle": ("ms", "over_robot"),
        "cycle": ("fast_sync_read", "usb_latency_ms", "rate_hz", "p99_ms"),
        "step": ("control", "load", "rise_ms", "overshoot_deg", "error_deg"),
        "age": ("nodes", "p50_ms", "p99_ms", "largest_ms"),
    },
}
"""Columns of the rows that a section shows, by benchmark and kind; "" is a row without a kind.

Of repeats their median is shown.
"""


def section(name: str, subject: str, result: Result) -> str:
    """Text of a benchmark's section after its heading: origin, checks, rows, pictures."""
    run = (
        "A quick run: fewer repeats, rougher figures"
        if result.quick
        else "A full run"
    )
    checks = [
        [
            plain(check.name),
            f"{_cell(check.value)} {plain(check.unit)}".rstrip(),
            plain(check.goal),
            "holds" if check.holds else "**missed**",
        ]
        for check in result.checks
    ]
    parts = [
        plain(subject),
        f"{run}, {plain(result.origin)}.",
        table(["check", "value", "goal", ""], checks).rstrip(),
    ]
    for kind, columns in SHOWN.get(name, {}).items():
        cells = [
            [_cell(row.get(column)) for column in columns]
            for row in result.rows
            if row.get("kind", "") == kind
            and row.get("repeat", "median") == "median"
        ]
        if cells:
            heads = [plain(column.replace("_", " ")) for column in columns]
            parts += [f"Rows {kind or name}:", table(heads, cells).rstrip()]
    parts += [
        f"![{name}: {Path(file).stem.replace('_', ' ')}]({file})"
        for file, picture in PICTURES.items()
        if picture.benchmark == name
    ]
    return "\n\n".join(parts)


def _cell(value: Any) -> str:
    """A cell of a table: a number with four digits, a dash where there is none."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return plain(value)
    found = number(value)
    return "-" if found is None else f"{found:.4g}"


def page(results: Path, before: str) -> str:
    """The page: sections of the results, and those of the page before without a new result."""
    parts = [INTRODUCTION.rstrip()]
    kept = dict(
        re.findall(r"^## (\w+)\n\n(.*?)(?=^## |\Z)", before, re.M | re.S)
    )
    for name, subject in known().items():
        result = read_result(results, name)
        text = kept.get(
            name, f"Not measured yet: `scripts/bench {name}`."
        ).rstrip()
        if result is not None:
            text = section(name, subject, result)
        parts.append(f"## {name}\n\n{text}")
    return "\n\n".join(parts) + "\n"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/docs --figures`; one line and exit code 2 for a bad result."""
    parser = command_parser("docs --figures", __doc__)
    add = parser.add_argument
    add(
        "--results",
        type=Path,
        default=ROOT / "results",
        metavar="DIR",
        help="default: results",
    )
    add(
        "--out",
        type=Path,
        default=DOC / "figures.md",
        metavar="FILE",
        help="default: the page",
    )
    options = parser.parse_args(arguments)
    return write_page(
        parser,
        options,
        lambda: page(
            options.results,
            options.out.read_text() if options.out.is_file() else "",
        ),
    )


if __name__ == "__main__":
    sys.exit(main())
