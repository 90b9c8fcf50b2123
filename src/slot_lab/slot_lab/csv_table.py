"""CSV files of measurements: a line of column names, then rows.

Lines that begin with # are comments. Errors name file, line, column and cause. A trajectory in
the format of TUM has no line of names: time x y z qx qy qz qw, separated by spaces.
"""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import time_fault, unit_of
from slot_core.refusal import InputError, quoted, read_text
from slot_core.robot import POINT_COLUMNS

PointRow = tuple[float, str, Array]  # time, s; name of a point; place (3,), m
SIZE_MAX = 200_000_000  # bytes of a file
TUM = ("time", "x", "y", "z", "qx", "qy", "qz", "qw")


class TableError(InputError):
    """A file that cannot be used; the message is one line."""


@dataclass(frozen=True)
class CsvRow:
    """Cells of a line by column, without surrounding spaces."""

    line: int  # in the file, from 1
    where: str  # file and line, for messages
    cells: Mapping[str, str]

    def number(self, column: str, hint: str = "") -> float:
        """The finite number in a column; raises TableError, whose message ends with the hint."""
        text = self.cells[column]
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise TableError(
                f"{self.where}, {column}: {quoted(text)} is not a finite number{hint}"
            )
        return value


@dataclass(frozen=True)
class Table:
    """Column names and rows of a file."""

    comments: tuple[str, ...]  # without #
    head: str  # file and line of the column names, for messages
    columns: tuple[str, ...]
    rows: tuple[CsvRow, ...]


def increasing_numbers(
    rows: Sequence[CsvRow], names: Sequence[str], hint: str = ""
) -> Array:
    """Numbers (n, m) of the columns `names`, the first of which is a time in s.

    Raises TableError for a time that does not increase, is in another unit or has been set, and
    for a cell without a finite number.
    """
    values = np.reshape(
        [[row.number(name, hint) for name in names] for row in rows],
        (len(rows), len(names)),
    )
    for before, row, step in zip(rows, rows[1:], np.diff(values[:, 0])):
        if step <= 0.0:
            raise TableError(
                f"{row.where}, {names[0]}: does not increase after line {before.line}"
            )
    if (unit := unit_of(values[:, 0])) != "s":
        raise TableError(
            f"{rows[0].where}, {names[0]}: median step {np.median(np.diff(values[:, 0])):.4g}, so"
            f" likely in {unit}; expected s, steps of 1e-05 to 0.5"
        )
    if fault := time_fault(values[:, 0]):
        raise TableError(f"{rows[0].where}, {names[0]}: {fault}")
    return values


def read_table(path: Path) -> Table:
    """Read a file; raises TableError, also for a row with more or fewer cells than columns."""
    try:
        text = read_text(path, SIZE_MAX)
    except UnicodeDecodeError:
        raise TableError(f"{path}: not a text file") from None
    except (OSError, ValueError) as error:
        raise TableError(
            f"{path}: {getattr(error, 'strerror', None) or error}"
        ) from None
    comments = [
        line[1:].strip()
        for line in map(str.strip, text.splitlines())
        if line[:1] == "#"
    ]
    lines = list(_lines(path, text))
    if not lines:
        raise TableError(f"{path}: is empty: no line of column names")
    if len(lines[0][2]) == 1 and len(lines[0][2][0].split()) == len(TUM):
        lines = [
            (n, where, " ".join(cells).split()) for n, where, cells in lines
        ]
        lines.insert(0, (0, lines[0][1], [*TUM]))
    (_, head, columns), *data = lines
    rows = []
    for number, where, cells in data:
        if len(cells) != len(columns):
            raise TableError(
                f"{where}: {len(cells)} cells, {len(columns)} columns"
            )
        rows.append(CsvRow(number, where, dict(zip(columns, cells))))
    return Table(tuple(comments), head, tuple(columns), tuple(rows))


def write_points(
    path: Path, rows: Iterable[PointRow], comments: Sequence[str]
) -> None:
    """Write places of points as CSV: time, point, x, y, z, in s and m; raises OSError."""
    with path.open("w", newline="") as file:
        file.writelines(f"# {comment}\n" for comment in comments)
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(POINT_COLUMNS)
        for time, name, place in rows:
            writer.writerow([f"{time:.6f}", name, *(f"{v:.6f}" for v in place)])


def _lines(path: Path, text: str) -> Iterator[tuple[int, str, list[str]]]:
    """Number, place and cells of every line that is neither empty nor a comment."""
    for number, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            where = f"{path}, line {number}"
            try:
                cells = next(csv.reader([line], strict=True))
            except csv.Error as error:
                raise TableError(f"{where}: {error}") from None
            yield number, where, [cell.strip() for cell in cells]
