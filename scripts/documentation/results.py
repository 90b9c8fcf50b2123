"""Results of benchmarks and of validations, read from their files."""

import csv
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.harness import Check
from slot_core.refusal import InputError, quoted
from slot_lab.desk_command import Outcome, run_command


class ReportError(InputError):
    """A result that cannot be read, or a page or picture that cannot be made; one line."""


@dataclass(frozen=True)
class Result:
    """Result of a command, read from its directory."""

    origin: str  # revision and machine, or what is known of them
    rows: Sequence[Mapping[str, Any]]
    checks: Sequence[Check] = ()
    quick: bool = False


def read_result(directory: Path, name: str) -> Result | None:
    """Result that scripts/bench, or else scripts/validate, wrote to `directory/name`; None if not there.

    Raises ReportError for a file that they did not write so, and OSError.
    """
    path = directory / name / f"{name}.json"
    if not path.is_file():
        return _read_errors(directory / name / "errors.csv")
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        if found["name"] != name:
            raise ValueError(
                f"name: expected {name!r}, got {quoted(found['name'])}"
            )
        return Result(
            _origin(found["revision"], found["machine"]),
            [dict(row) for row in found["rows"]],
            [_check(check) for check in found["checks"]],
            found["quick"],
        )
    except (
        LookupError,
        TypeError,
        ValueError,
        AttributeError,
        RecursionError,
    ) as error:
        why = f"no {error}" if isinstance(error, KeyError) else error
        raise ReportError(
            f"{path}: not a result of scripts/bench: {why}"
        ) from None


def write_page(parser: Any, options: Any, make: Callable[[], str]) -> int:
    """Write a page to `options.out` and print its path; returns the exit code of the command."""

    def write(*_: object) -> Outcome:
        page = make()
        options.out.parent.mkdir(parents=True, exist_ok=True)
        options.out.write_text(page, encoding="utf-8", errors="replace")
        return [str(options.out)], 0

    return run_command(parser, options, write)


def number(value: Any) -> float | None:
    """`value` if it is a finite number; else None, as where a benchmark found none."""
    numeric = isinstance(value, (int, float)) and not isinstance(value, bool)
    return (
        float(value) if numeric and abs(value) <= sys.float_info.max else None
    )


def _check(found: Mapping[str, Any]) -> Check:
    value = number(found["value"])
    return Check(**{**found, "value": math.nan if value is None else value})


def _origin(revision: Mapping[str, Any], machine: Mapping[str, Any]) -> str:
    commit = revision["describe"] or "unknown"
    changed = " with changes" if revision["dirty"] else ""
    return (
        f"revision {commit}{changed}; {machine['cpu']}, {machine['architecture']}, "
        f"{machine['cores']} cores, {machine['system']}; Python {machine['python']}, "
        f"NumPy {machine['numpy']}"
    )


def _read_errors(path: Path) -> Result | None:
    """Rows of the errors.csv of scripts/validate, if it is there: point, axis, and numbers."""
    if not path.is_file():
        return None
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
        rows = [
            {
                k: v if k in ("point", "axis") else float(v)
                for k, v in row.items()
            }
            for row in csv.DictReader(lines)
        ]
    except (TypeError, ValueError) as error:
        raise ReportError(
            f"{path}: not a table of scripts/validate: {error}"
        ) from None
    return Result("scripts/validate, revision not recorded", rows)
