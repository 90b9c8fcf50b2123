"""Measurements of single legs: a CSV file (`csv_table.py`) with one measurement a row.

    kind,theta_deg,load_N,height_m,friction,place,value,sigma
    marker_range,116.28,4.905,,0.3,0,0.0886,0.002
    force_angle,90,,0.105,0.3,,2.72,0.25
    deflection,0,1.0,,,1,0.0235,0.0005

Each kind has its own conditions; the other cells are empty:

`marker_range`  the vertically guided clamp carries `load_N` in addition to the leg; the tendon is
                pulled from rest to `theta_deg`. Value: range of the height of the point at `place`,
                m.
`force_angle`   the clamp is held at `height_m`; the tendon is pulled from slack to `theta_deg`.
                Value: vertical force of the floor, N.
`deflection`    the leg hangs from its clamp without floor, the tendon held at `theta_deg`; a weight
                of `load_N` is hung from its tip. Value: downward displacement of the point at
                `place`, m.

`theta_deg` is the angle of the tendon's spool, `friction` the coefficient of the floor, `place` the
share of the leg's arc length from the clamp (0 to 1), `sigma` the standard uncertainty of the
value.
"""

import hashlib
import math
from dataclasses import dataclass
from pathlib import Path

from slot_core.refusal import quoted, read_bytes
from slot_lab.csv_table import SIZE_MAX, CsvRow, TableError, read_table

CONDITIONS = {
    "marker_range": ("theta_deg", "load_N", "friction", "place"),
    "force_angle": ("theta_deg", "height_m", "friction"),
    "deflection": ("theta_deg", "load_N", "place"),
}
BOUNDS = {
    "theta_deg": (0.0, 360.0),
    "load_N": (0.05, 49.0),  # a torso of 0.02 to 20 kg on four legs
    "height_m": (0.0, 1.0),
    "friction": (0.0, 5.0),
    "place": (0.0, 1.0),
    "value": (-1e6, 1e6),
    "sigma": (1e-12, 1e6),
}
COLUMNS = ("kind", *BOUNDS)


@dataclass(frozen=True)
class Datum:
    """One measurement; conditions that its kind does not have are NaN."""

    kind: str
    theta_deg: float
    load_N: float  # noqa: N815 - as the column
    height_m: float
    friction: float
    place: float
    value: float  # m or N
    sigma: float  # standard uncertainty of the value
    line: int  # in the file

    def conditions(self) -> dict[str, float]:
        """Conditions of its kind by name."""
        return {name: getattr(self, name) for name in CONDITIONS[self.kind]}


@dataclass(frozen=True)
class Data:
    """Measurements of a file."""

    name: str
    sha256: str  # of the file
    rows: tuple[Datum, ...]


def read_data(path: Path) -> Data:
    """Read a file of measurements; raises TableError."""
    table = read_table(path)
    columns = table.columns
    if missing := [name for name in COLUMNS if name not in columns]:
        raise TableError(f"{table.head}: column {missing[0]} is missing")
    if unknown := [name for name in columns if name not in COLUMNS]:
        raise TableError(
            f"{table.head}: column {quoted(unknown[0])} is unknown"
            f" (known: {', '.join(COLUMNS)})"
        )
    if len(columns) > len(COLUMNS):
        raise TableError(f"{table.head}: a column is repeated")
    if not table.rows:
        raise TableError(f"{path}: no measurements")
    return Data(
        path.name,
        hashlib.sha256(read_bytes(path, SIZE_MAX)).hexdigest(),
        tuple(_datum(row) for row in table.rows),
    )


def _datum(row: CsvRow) -> Datum:
    kind = row.cells["kind"]
    if kind not in CONDITIONS:
        raise TableError(
            f"{row.where}, kind: {quoted(kind)} is unknown"
            f" (known: {', '.join(CONDITIONS)})"
        )
    needed = {*CONDITIONS[kind], "value", "sigma"}
    numbers = {name: _number(row, name, name in needed) for name in BOUNDS}
    return Datum(kind, line=row.line, **numbers)


def _number(row: CsvRow, name: str, needed: bool) -> float:
    text, (low, high) = row.cells[name], BOUNDS[name]
    if needed:
        value = row.number(name)
        if not low <= value <= high:
            raise TableError(
                f"{row.where}, {name}: {text} is outside [{low:g}, {high:g}]"
            )
        return value
    if text:
        raise TableError(
            f"{row.where}, {name}: {quoted(text)}, but {row.cells['kind']} has none;"
            " leave it empty"
        )
    return math.nan
