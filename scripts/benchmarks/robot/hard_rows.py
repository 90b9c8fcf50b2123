"""Rows of the robot benchmark: records of the hard cases, and whether their limits hold."""

from __future__ import annotations

import dataclasses
from typing import Any

from benchmarks.robot.hard_cases import CASES
from benchmarks.robot.stress import examine


def hard_rows() -> list[dict[str, Any]]:
    """A row for each hard case: its record, its limits (`limit_...`) and whether they hold."""
    rows = []
    for name, case in CASES.items():
        record, limits = examine(case), dataclasses.asdict(case.limits)
        limits = {f"limit_{key}": value for key, value in limits.items()}
        row = {"case": name, **dataclasses.asdict(record), **limits}
        rows.append({**row, "holds": record.holds(case.limits)})
    return rows
