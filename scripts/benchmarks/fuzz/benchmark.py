"""Hostile input: configuration, command lines, bags, packets and calls, and how each is refused.

Every part runs in a process of its own from a fixed seed, so that an input that ends the process is
counted too. A refusal is an error of the project or, of a command line, exit code 2; its message is
one printable line of at most 300 characters. `accepted` counts input that is known to be wrong, yet
was used; mutated files may be right by chance, and are not counted there.
"""

from __future__ import annotations

import dataclasses
import multiprocessing
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from benchmarks.fuzz.outcomes import Outcomes, tally_of
from benchmarks.harness import Check, Progress, Row, at_most

COUNTS = {  # quick, full
    "files": (200, 20_000),
    "commands": (20, 5_000),
    "bags": (8, 3_000),
    "packets": (500, 100_000),
    "calls": (100, 10_000),
}
KINDS = ("exceptions", "long", "unprintable", "hangs", "accepted")


def run(quick: bool, out: Path, progress: Progress) -> tuple[list[Row], list[Check]]:
    """Run all parts; each starts with its seed."""
    rows: list[dict[str, Any]] = []
    for part, counts in COUNTS.items():
        progress(part)
        rows.append({"part": part} | dataclasses.asdict(apart(part, counts[not quick])))
    return list(rows), checks(rows)


def apart(part: str, count: int) -> Outcomes:
    """Run a part in a process of its own; one that ends early counts as an exception."""
    with ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool:
        try:
            return pool.submit(tally_of, part, count).result()
        except BrokenProcessPool:
            return Outcomes(tried=count, exceptions=1, example="the process ended")


def checks(rows: Sequence[Row]) -> list[Check]:
    """Check of each part: no fault of any kind."""
    return [at_most(f"{row['part']}: {kind}", row[kind], 0) for row in rows for kind in KINDS]
