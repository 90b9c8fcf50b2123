"""The page of results in Markdown, with links to the pictures beside them."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.harness import Check
from benchmarks.report import claims, paper_figures
from benchmarks.report.paper_figures import Ours, PaperComparison, TableColumn
from benchmarks.report.results import Result, number
from documentation.markdown import plain, table

COLUMNS = ("gait alone", "paper", "default")  # of the locomotion table
MARGINS = {
    "voltage": "V",
    "friction": "",
    "speed": "m/s",
    "aside": "mm per m walked",
    "heading": "deg",
    "tilt": "deg RMS",
    "load": "% of stall",
}
NOT_MEASURED, MISSING, NO_VALUE = "not measured", "result missing", "no value"
VERDICTS = (
    "better",
    "equal",
    "reproduced",
    "worse",
    "not reproduced",
    NOT_MEASURED,
    MISSING,
    NO_VALUE,
)
ABOUT = """\
Everything is of the simulated robot, unless it is the paper's: S. Karan, N. Maram, S. Borate, M. Vadali,
*Dynamic Modeling and MPC for Locomotion of Tendon-Driven Soft Quadruped*."""
PAPER = """\
The paper's figures with their places, and the figure of ours that corresponds. Where both are of the same thing
they are judged by the number alone; the text above each table says what differs."""
REFUTED = """\
Refuted means by the paper's own numbers, its published code, or ours, as the reason says; what is not addressable
rests on what is not published, or needs the real robot."""
RUNS = """\
The commands are those that this page expects. Revision and arguments are those that the bag of the run holds; a
comparison records neither."""


@dataclass(frozen=True)
class Contents:
    """Results that a page shows, and the commands that make them."""

    benchmarks: Mapping[
        str, tuple[str, Result | None]
    ]  # by name: what it measures, its result
    runs: Mapping[str, tuple[str, Result | None]]  # by folder: title, its result
    commands: Mapping[str, Sequence[str]]  # by name or folder

    def results(self) -> dict[str, Result]:
        """All results that are there, by name or folder."""
        found = {**self.benchmarks, **self.runs}
        return {
            name: result for name, (_, result) in found.items() if result is not None
        }


def render(contents: Contents, revision: str, folder: Path) -> str:
    """The page, made at a revision of the project, for a file in `folder`."""
    results = contents.results()
    compared = {c.title: _comparison(c, results) for c in paper_figures.comparisons()}
    counts = {title: count for title, (_, count) in compared.items()}
    parts = [
        f"# Results\n\nMade by `scripts/report` at revision {plain(revision)}. {ABOUT}",
        *_overview(contents, counts),
        f"## The paper beside ours\n\n{PAPER}",
        *(section for section, _ in compared.values()),
        _claims(),
        "## Benchmarks",
        *_sections(contents.benchmarks, folder),
        f"## Runs\n\n{RUNS}",
        *_sections(contents.runs, folder),
        *_missing(contents),
    ]
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"


def _overview(contents: Contents, counts: Mapping[str, Counter[str]]) -> Iterator[str]:
    """How many results are there, how many checks hold, and how the paper's figures are judged."""
    results = contents.results()
    checks = [
        (name, check) for name, result in results.items() for check in result.checks
    ]
    missed = [(name, check) for name, check in checks if not check.holds]
    yield (
        f"{len(results)} of {len(contents.commands)} results are here. Of {len(checks)} checks of "
        f"benchmarks {len(checks) - len(missed)} hold and {len(missed)} are missed."
    )
    judged = [
        [plain(t), *(str(count[v] or "") for v in VERDICTS)]
        for t, count in counts.items()
    ]
    yield table(["figures of the paper", *VERDICTS], judged)
    if missed:
        rows = [
            [_link(name), plain(c.name), _value(c), plain(c.goal)] for name, c in missed
        ]
        yield table(["missed in", "check", "value", "goal"], rows)


def _comparison(
    compared: PaperComparison, results: Mapping[str, Result]
) -> tuple[str, Counter[str]]:
    """Section of a table of the paper beside ours, and how many figures have which verdict."""
    here = any(name in results for name in compared.results)
    rows, count = [], Counter[str]()
    for line in compared.lines:
        papers = [""] * len(compared.others) or line.paper
        cells = [
            _figure(
                ours,
                column.judged if line.judged is None else line.judged,
                paper,
                results,
            )
            for column, paper, ours in zip(
                compared.ours, papers, line.ours, strict=True
            )
        ]
        count.update(verdict or text for text, verdict in cells)
        given = [f"{v:g}" if isinstance(v, float) else v for v in line.paper]
        name = plain(line.name + (f" ({line.place})" if line.place else ""))
        rows.append(
            [name, *given, *(f"{text} {word}".strip() for text, word in cells if here)]
        )
    columns = [f"paper: {_title(column)}" for column in compared.columns]
    columns += [f"here: {_title(column)}" for column in compared.ours if here]
    names = ", ".join(_link(name) for name in compared.results if name in results)
    missing = ", ".join(name for name in compared.results if name not in results)
    ends = [
        f"From {names}." if names else "",
        f"Not run: {missing}." if missing else "",
    ]
    about = f"### {compared.title}\n\n{plain(compared.place)}. {plain(compared.about)}"
    return (
        f"{about}\n\n{table(['', *columns], rows)}\n{' '.join(filter(None, ends))}",
        count,
    )


def _figure(
    ours: Ours | None, judged: str, paper: float | str, results: Mapping[str, Result]
) -> tuple[str, str]:
    """Our figure or why there is none, and its verdict beside the paper's or ""."""
    if ours is None:
        return NOT_MEASURED, ""
    if ours.result not in results:
        return MISSING, ""
    value = paper_figures.find(ours, results[ours.result].rows)
    verdict = "" if value is None else paper_figures.judge(judged, paper, value)
    return _number(value), verdict


def _claims() -> str:
    count = Counter(claim.verdict for claim in claims.CLAIMS)
    counts = ", ".join(f"{count[verdict]} {verdict}" for verdict in claims.VERDICTS)
    rows = [
        [plain(claim.place), plain(claim.text), claim.verdict, plain(claim.reason)]
        for claim in claims.CLAIMS
    ]
    about = f"### Claims one by one\n\nEvery quantitative claim of the paper: {counts}. {REFUTED}"
    return f"{about}\n\n{table(['place', 'claim', 'verdict', 'why'], rows)}"


def _sections(
    shown: Mapping[str, tuple[str, Result | None]], folder: Path
) -> Iterator[str]:
    """A section for each result that is there."""
    for name, (about, result) in shown.items():
        if result is None:
            continue
        yield f"### {name}\n\n{plain(about)}"
        quick = " A quick run: fewer repeats, rougher figures." if result.quick else ""
        yield f"```bash\n{result.command}\n```\n\n{plain(result.origin)}.{quick}"
        if result.checks:
            rows = [
                [
                    "holds" if c.holds else "**missed**",
                    plain(c.name),
                    _value(c),
                    plain(c.goal),
                ]
                for c in result.checks
            ]
            yield table(["", "check", "value", "goal"], rows)
        yield from _locomotion(result) if name == "locomotion" else ()
        if result.text:
            yield f"```text\n{result.text.rstrip()}\n```"
        for path, caption in result.images:
            yield f"![{plain(caption)}]({os.path.relpath(path, folder)})"
        if result.absent:
            yield f"Missing: {', '.join(result.absent)}. The commands above make it."


def _locomotion(result: Result) -> Iterator[str]:
    """Tables of the rows that have a goal, and of the walk's margins."""
    rows, margins = [], []
    for row in result.rows:
        if "row" in row:
            goal, larger = number(row.get("goal")), row.get("better") == "larger"
            values = [number(row.get(column)) for column in COLUMNS]
            known = goal is not None and values[-1] is not None
            holds = known and (values[-1] >= goal if larger else values[-1] <= goal)
            wanted = f"{'>=' if larger else '<='} {_number(goal)}"
            words = (plain(str(word)) for word in (row["row"], row.get("unit"), wanted))
            rows.append(
                [*words, *map(_number, values), "holds" if holds else "**missed**"]
            )
        elif row.get("kind") == "margin":
            margins.append([_number(number(row.get(column))) for column in MARGINS])
    if rows:
        yield (
            "The gait alone, the paper's pipeline and the default, each on the same simulated robot; "
            "the worst over the cases of a row. No value: no walk, or a fall."
        )
        yield table(["row", "unit", "goal", *COLUMNS, "of the default"], rows)
    if margins:
        yield "The default walk at 0.05 m/s, over friction and the servos' supply voltage."
        yield table(
            [f"{name}, {unit}".rstrip(", ") for name, unit in MARGINS.items()], margins
        )


def _missing(contents: Contents) -> Iterator[str]:
    there = contents.results()
    missing = {
        name: lines for name, lines in contents.commands.items() if name not in there
    }
    if missing:
        lines = [
            f"- {n}: {', then '.join(f'`{c}`' for c in cs)}"
            for n, cs in missing.items()
        ]
        yield "## What is missing\n\n" + "\n".join(lines)


def _title(column: TableColumn) -> str:
    return plain(column.name + (f", {column.unit}" if column.unit else ""))


def _link(name: str) -> str:
    return f"[{name}](#{name})"


def _value(check: Check) -> str:
    return f"{_number(number(check.value))} {plain(check.unit)}".rstrip()


def _number(value: float | None) -> str:
    """A number with four digits; a result without a finite number has no value."""
    return NO_VALUE if value is None else f"{value:.4g}"
