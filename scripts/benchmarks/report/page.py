"""The report as one HTML page: no script, nothing to load; light, dark and on paper."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from benchmarks.report import claims, paper_figures
from benchmarks.report.paper_figures import Ours, PaperComparison
from benchmarks.report.results import Result, number

HERE = Path(__file__).resolve().parent
COLUMNS = ("gait alone", "paper", "default")  # of the locomotion table
MARGINS = {
    "voltage": "V", "friction": "", "speed": "m/s", "aside": "mm per m walked",
    "heading": "deg", "tilt": "deg RMS", "load": "% of stall",
}  # fmt: skip
GOOD, BAD = ("better", "equal", "reproduced"), ("worse", "not reproduced")
NOT_MEASURED, MISSING, NO_VALUE = "not measured", "result missing", "no value"


@dataclass(frozen=True)
class Contents:
    """What a report shows."""

    robot: str  # page of a walk
    benchmarks: Mapping[str, tuple[str, Result | None]]  # by name: what it measures, its result
    runs: Mapping[str, tuple[str, Result | None]]  # by folder: title, what is there
    commands: Mapping[str, Sequence[str]]  # by name or folder: what makes it
    faults: Sequence[Sequence[str]]  # table of faults, head first

    def results(self) -> dict[str, Result]:
        """All results that are there."""
        found = {**self.benchmarks, **self.runs}
        return {name: result for name, (_, result) in found.items() if result is not None}

    def missing(self) -> dict[str, Sequence[str]]:
        """Commands of what is not there."""
        there = self.results()
        return {name: lines for name, lines in self.commands.items() if name not in there}


@dataclass(frozen=True)
class Cell:
    """A figure of ours beside the paper's."""

    text: str
    verdict: str = ""  # of GOOD and BAD, or ""


def render(contents: Contents, revision: str) -> str:
    """The page, made at a revision of the project; every text in it is escaped."""
    environment = Environment(
        loader=FileSystemLoader(HERE),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["figure"] = figure
    results = contents.results()
    compared = [compared_table(table, results) for table in paper_figures.comparisons()]
    checks = [check for result in results.values() for check in result.checks]
    return environment.get_template("page.html").render(
        contents=contents,
        revision=revision,
        results=results,
        missing=contents.missing(),
        compared=compared,
        claims=claims.CLAIMS,
        claimed=Counter(claim.verdict for claim in claims.CLAIMS),
        claim_verdicts=claims.VERDICTS,
        verdicts=(*GOOD, *BAD, NOT_MEASURED, MISSING, NO_VALUE),
        good=GOOD,
        checks=checks,
        locomotion=locomotion_rows(results.get("locomotion")),
        locomotion_columns=COLUMNS,
        margins=margin_rows(results.get("locomotion")),
        margin_columns=MARGINS,
    )


def compared_table(table: PaperComparison, results: Mapping[str, Result]) -> dict[str, Any]:
    """A comparison with our figures filled in, and how many have which verdict."""
    lines = []
    count: Counter[str] = Counter()
    for line in table.lines:
        cells = []
        papers = [""] * len(table.others) or line.paper
        for column, paper, ours in zip(table.ours, papers, line.ours, strict=True):
            judged = column.judged if line.judged is None else line.judged
            cell = our_cell(ours, judged, paper, results)
            cells.append(cell)
            count[cell.verdict or cell.text] += 1
        given = [f"{v:g}" if isinstance(v, float) else v for v in line.paper]
        lines.append({"name": line.name, "place": line.place, "paper": given, "ours": cells})
    here = any(name in results for name in table.results)
    return {"table": table, "lines": lines, "count": count, "here": here}


def our_cell(
    ours: Ours | None, judged: str, paper: float | str, results: Mapping[str, Result]
) -> Cell:
    """Our figure, or why there is none."""
    if ours is None:
        return Cell(NOT_MEASURED)
    if ours.result not in results:
        return Cell(MISSING)
    value = paper_figures.find(ours, results[ours.result].rows)
    if value is None:
        return Cell(NO_VALUE)
    return Cell(figure(value), paper_figures.judge(judged, paper, value))


def locomotion_rows(result: Result | None) -> list[dict[str, Any]]:
    """Rows of the locomotion table, each with whether the default reaches the goal."""
    rows = []
    for row in result.rows if result else ():
        if "row" not in row:  # a margin or an ablation
            continue
        goal, larger = number(row.get("goal")), row.get("better") == "larger"
        values = [number(row.get(column)) for column in COLUMNS]
        reached = values[-1]
        known = goal is not None and reached is not None
        holds = known and (reached >= goal if larger else reached <= goal)
        rows.append(
            {"name": row.get("row"), "unit": row.get("unit"), "sign": ">=" if larger else "<=",
             "goal": goal, "values": values, "holds": holds}
        )  # fmt: skip
    return rows


def margin_rows(result: Result | None) -> list[list[float | None]]:
    """Rows of the walk's margins over friction and supply voltage, in the order of MARGINS."""
    rows = [row for row in (result.rows if result else ()) if row.get("kind") == "margin"]
    return [[number(row.get(column)) for column in MARGINS] for row in rows]


def figure(value: float | None) -> str:
    """A number with four digits; a result without a finite number has no value."""
    finite = number(value)
    return NO_VALUE if finite is None else f"{finite:.4g}"
