"""The paper's figures and claims beside ours, as a page in Markdown."""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path

from documentation.markdown import plain, table
from documentation.results import ReportError, Result, number, read_result
from slot_paper import claims
from slot_paper.tables import TABLES, Line, Ours, PaperTable, TableColumn, judge

NOT_MEASURED, MISSING, NO_VALUE = "not measured", "result missing", "no value"
INTRODUCTION = """\
# The paper beside ours

Everything is of the simulated robot, unless it is the paper's: S. Karan, N. Maram, S. Borate, M. Vadali,
*Dynamic Modeling and MPC for Locomotion of Tendon-Driven Soft Quadruped*. The paper's figures stand with their
places, and the figure of ours that corresponds. Where both are of the same thing they are judged by the number
alone; the text above each table says what differs."""
REFUTED = """\
Refuted means by the paper's own numbers, its published code, or ours, as the reason says; what is not addressable
rests on what is not published, or needs the real robot."""
EXAMPLE = "slot_bringup/example"
COMMANDS = {
    "single_leg": f"scripts/validate {EXAMPLE}/single_leg_run.csv {EXAMPLE}/single_leg_markers.csv"
    " --out DIR/single_leg",
    "walk_validated": f"scripts/twin {EXAMPLE}/walk --out DIR/walk_validated, then scripts/validate"
    f" DIR/walk_validated/predicted.csv {EXAMPLE}/walk_markers.csv --frame-time 1.5 --out DIR/walk_validated",
}
"""Command lines of the results that are no benchmark's."""


def page(directory: Path, out: Path) -> str:
    """The page of the results in a directory, for a file; raises ReportError."""
    if out.suffix != ".md":
        raise ReportError(f"--out {out}: expected a name that ends in .md")
    if not directory.is_dir():
        raise ReportError(
            f"--results {directory}: not a directory; scripts/bench NAME makes one"
        )
    names = dict.fromkeys(n for compared in TABLES for n in compared.results)
    read = {name: read_result(directory, name) for name in names}
    results = {name: found for name, found in read.items() if found}
    origins = [
        [name, plain(found.origin)] for name, found in results.items()
    ] + [
        [name, f"missing: `{COMMANDS.get(name, f'scripts/bench {name}')}`"]
        for name in names
        if name not in results
    ]
    parts = [
        INTRODUCTION,
        *(_comparison(compared, results) for compared in TABLES),
        _claims(),
        f"## Results\n\n{table(['result', 'from'], origins)}",
    ]
    return "\n\n".join(part.rstrip("\n") for part in parts) + "\n"


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
    about = f"## {compared.title}\n\n{plain(compared.place)}. {plain(compared.about)}"
    return f"{about}\n\n{table(['', *columns], rows)}\nFrom {', '.join(compared.results)}."


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
            shown = NO_VALUE if value is None else f"{value:.4g}"
            yield f"{shown} {judge(judged, paper, value)}".strip()


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
    about = f"## Claims one by one\n\nEvery quantitative claim of the paper: {counts}. {REFUTED}"
    return f"{about}\n\n{table(['place', 'claim', 'verdict', 'why'], rows)}"


def _title(column: TableColumn) -> str:
    return plain(column.name + (f", {column.unit}" if column.unit else ""))
