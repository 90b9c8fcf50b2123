"""The page of results in Markdown, with links to the pictures beside them."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from benchmarks.harness import Check
from benchmarks.report.results import (
    CAPTIONS,
    ReportError,
    ReportSection,
    Result,
    number,
    read_benchmarks,
    read_runs,
)
from documentation.markdown import plain, table
from slot_paper import claims
from slot_paper.tables import TABLES, Line, Ours, PaperTable, TableColumn, judge

COLUMNS = ("gait alone", "paper", "default")  # of the locomotion table
NOT_MEASURED, MISSING, NO_VALUE = "not measured", "result missing", "no value"
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
ROWS = """\
The gait alone, the paper's pipeline and the default, each on the same simulated robot; the worst over the cases
of a row. No value: no walk, or a fall."""


def render(directory: Path, revision: str, folder: Path) -> str:
    """The page of the results in a directory, at a revision of the project, for a file in `folder`.

    Raises ReportError.
    """
    if not directory.is_dir():
        raise ReportError(
            f"--results {directory}: not a directory; scripts/bench NAME makes one"
        )
    benchmarks, runs = read_benchmarks(directory), read_runs(directory)
    sections = {**benchmarks, **runs}
    results = {
        name: s.result for name, s in sections.items() if s.result is not None
    }
    parts = [
        f"# Results\n\nMade by `scripts/report` at revision {plain(revision)}. {ABOUT}",
        *_overview(results, len(sections)),
        f"## The paper beside ours\n\n{PAPER}",
        *(_comparison(compared, results) for compared in TABLES),
        _claims(),
        "## Benchmarks",
        *_sections(benchmarks, folder),
        f"## Runs\n\n{RUNS}",
        *_sections(runs, folder),
    ]
    missing = [
        f"- {name}: {', then '.join(f'`{command}`' for command in section.commands)}"
        for name, section in sections.items()
        if section.result is None
    ]
    if missing:
        parts.append("\n".join(["## What is missing\n", *missing]))
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"


def _overview(results: Mapping[str, Result], known: int) -> Iterator[str]:
    """How many results are there, and which checks are missed."""
    count = sum(len(result.checks) for result in results.values())
    missed = [
        [_link(name), *_cells(check)]
        for name, result in results.items()
        for check in result.checks
        if not check.holds
    ]
    yield (
        f"{len(results)} of {known} results are here. Of {count} checks of "
        f"benchmarks {count - len(missed)} hold and {len(missed)} are missed."
    )
    if missed:
        yield table(["missed in", "check", "value", "goal"], missed)


def _comparison(compared: PaperTable, results: Mapping[str, Result]) -> str:
    """Section of a table of the paper beside ours."""
    here = any(name in results for name in compared.results)
    columns = [f"paper: {_title(column)}" for column in compared.columns]
    if here:
        columns += [f"here: {_title(column)}" for column in compared.columns]
    rows = []
    for line in compared.lines:
        name = plain(line.name + (f" ({line.place})" if line.place else ""))
        given = [f"{v:g}" if isinstance(v, float) else v for v in line.paper]
        found = _figures(line, compared, results) if here else []
        rows.append([name, *given, *found])
    names = [_link(name) for name in compared.results if name in results]
    missing = [name for name in compared.results if name not in results]
    ends = [f"From {', '.join(names)}."] if names else []
    ends += [f"Not run: {', '.join(missing)}."] if missing else []
    about = f"### {compared.title}\n\n{plain(compared.place)}. {plain(compared.about)}"
    return f"{about}\n\n{table(['', *columns], rows)}\n{' '.join(ends)}"


def _figures(
    line: Line, compared: PaperTable, results: Mapping[str, Result]
) -> Iterator[str]:
    """Our figures in a line, each with its verdict, or why there is none."""
    for column, paper, ours in zip(
        compared.columns, line.paper, line.ours, strict=True
    ):
        if ours is None:
            yield NOT_MEASURED
        elif ours.result not in results:
            yield MISSING
        else:
            value = find(ours, results[ours.result])
            judged = column.judged if line.judged is None else line.judged
            yield f"{_number(value)} {judge(judged, paper, value)}".strip()


def find(ours: Ours, result: Result) -> float | None:
    """Our number in a result, in the unit of its table; None if no row has it as a number."""
    row = next(
        (row for row in result.rows if ours.match.items() <= row.items()), {}
    )
    value = number(row.get(ours.name))
    return None if value is None else ours.factor * value


def _claims() -> str:
    count = Counter(claim.verdict for claim in claims.CLAIMS)
    counts = ", ".join(
        f"{count[verdict]} {verdict}" for verdict in claims.VERDICTS
    )
    rows = [
        [
            plain(claim.place),
            plain(claim.text),
            claim.verdict,
            plain(claim.reason),
        ]
        for claim in claims.CLAIMS
    ]
    about = f"### Claims one by one\n\nEvery quantitative claim of the paper: {counts}. {REFUTED}"
    return f"{about}\n\n{table(['place', 'claim', 'verdict', 'why'], rows)}"


def _sections(
    sections: Mapping[str, ReportSection], folder: Path
) -> Iterator[str]:
    """A section for each result that is there."""
    for name, section in sections.items():
        result = section.result
        if result is None:
            continue
        yield f"### {name}\n\n{plain(section.about)}"
        quick = (
            " A quick run: fewer repeats, rougher figures."
            if result.quick
            else ""
        )
        yield f"```bash\n{result.command}\n```\n\n{plain(result.origin)}.{quick}"
        if result.checks:
            yield table(
                ["", "check", "value", "goal"],
                [
                    ["holds" if check.holds else "**missed**", *_cells(check)]
                    for check in result.checks
                ],
            )
        if name == "locomotion":
            yield f"{ROWS}\n\n{_locomotion(result)}"
        if result.text:
            yield f"```text\n{result.text.rstrip()}\n```"
        for path in result.images:
            caption = plain(CAPTIONS.get(path.name, path.stem))
            yield f"![{caption}]({os.path.relpath(path, folder)})"


def _locomotion(result: Result) -> str:
    """Table of the rows that have a goal."""
    rows = []
    for row in result.rows:
        if "row" in row:
            sign = ">=" if row.get("better") == "larger" else "<="
            goal = f"{sign} {_number(number(row.get('goal')))}"
            words = (row["row"], row.get("unit"), goal)
            values = [_number(number(row.get(column))) for column in COLUMNS]
            rows.append([*(plain(str(word)) for word in words), *values])
    return table(["row", "unit", "goal", *COLUMNS], rows)


def _title(column: TableColumn) -> str:
    return plain(column.name + (f", {column.unit}" if column.unit else ""))


def _link(name: str) -> str:
    return f"[{name}](#{name})"


def _cells(check: Check) -> list[str]:
    """Name, value and goal of a check."""
    value = f"{_number(number(check.value))} {plain(check.unit)}".rstrip()
    return [plain(check.name), value, plain(check.goal)]


def _number(value: float | None) -> str:
    """A number with four digits; a result without a finite number has no value."""
    return NO_VALUE if value is None else f"{value:.4g}"
