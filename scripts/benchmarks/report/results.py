"""Results of benchmarks and runs: read from their files, checked, with the command behind each."""

from __future__ import annotations

import csv
import json
import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.harness import Check
from slot_core.recording.bag_error import BagError
from slot_core.refusal import InputError, quoted


class ReportError(InputError):
    """A result that cannot be read, or a report that cannot be written; the message is one line."""


@dataclass(frozen=True)
class Result:
    """Result of a command, read from its directory."""

    command: str
    origin: str  # revision and machine, or what is known of them
    quick: bool
    rows: Sequence[Mapping[str, Any]]
    checks: Sequence[Check]
    images: Sequence[tuple[Path, str]]  # with captions
    text: str = ""  # summary
    absent: Sequence[str] = ()  # images that are not there


@dataclass(frozen=True)
class Run:
    """Files of a run, a comparison or a fit in `folder` of the results."""

    folder: str
    title: str
    commands: Sequence[str]  # {} stands for the folder
    images: Mapping[str, str]  # captions by file; the first one has to exist


def read_benchmark(
    directory: Path, name: str, captions: Mapping[str, str]
) -> Result | None:
    """`directory/name/name.json` or `directory/name.json` with its images; None if not there.

    Raises ReportError for a file that scripts/bench did not write so.
    """
    places = (directory / name / f"{name}.json", directory / f"{name}.json")
    path = next((place for place in places if place.is_file()), None)
    if path is None:
        return None
    found, images = _load(path), _images(path, name, captions)
    try:
        if found["name"] != name:
            raise ValueError(f"name: expected {name!r}, got {quoted(found['name'])}")
        quick, command = (
            found["quick"],
            bench_command(name, found["quick"], found["options"]),
        )
        origin = _origin(found["revision"], found["machine"])
        rows, checks = (
            [dict(row) for row in found["rows"]],
            list(map(_check, found["checks"])),
        )
        return Result(command, origin, quick, rows, checks, images)
    except KeyError as error:
        raise ReportError(
            f"{path}: not a result of scripts/bench: no {error}"
        ) from None
    except (TypeError, ValueError, AttributeError) as error:
        raise ReportError(f"{path}: not a result of scripts/bench: {error}") from None


def bench_command(name: str, quick: bool, options: Mapping[str, Any]) -> str:
    """Command line that made a result, with all its options."""
    words = ["scripts/bench", name, *(["--quick"] if quick else [])]
    for option, value in sorted(options.items()):
        flag = f"--{option.replace('_', '-')}"
        if value is True:
            words.append(flag)
        elif not (value is None or value is False or value == ""):
            words += [flag, str(value)]
    return shlex.join(words)


def read_run(directory: Path, run: Run) -> Result | None:
    """Result of `run` in its folder of `directory`; None if its first image is not there.

    Raises ReportError for a damaged bag or table.
    """
    folder = directory / run.folder
    if not (folder / next(iter(run.images))).is_file():
        return None
    there = [file for file in run.images if (folder / file).is_file()]
    summary, errors = folder / "summary.txt", folder / "errors.csv"
    rows = _read_errors(errors) if errors.is_file() else []
    images = [(folder / file, run.images[file]) for file in there]
    text = _read_text(summary) if summary.is_file() else ""
    absent = [file for file in run.images if file not in there]
    command, origin = "\n".join(commands(directory, run)), _bag_origin(folder)
    return Result(command, origin, False, rows, [], images, text, absent)


def commands(directory: Path, run: Run) -> list[str]:
    """Command lines of a run, whose results go below `directory`."""
    return [
        line.replace("{}", shlex.quote(str(directory / run.folder)))
        for line in run.commands
    ]


def number(value: Any) -> float | None:
    """`value` if it is a finite number; else None, as where a benchmark found none."""
    numeric = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if numeric and abs(value) <= sys.float_info.max else None


def _load(path: Path) -> Mapping[str, Any]:
    text = _read_text(path)
    try:
        found = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise ReportError(f"{path}: not JSON: {error}") from None
    if not isinstance(found, dict):
        raise ReportError(f"{path}: not a result of scripts/bench: no mapping")
    return found


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ReportError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ReportError(f"{path}: not text in UTF-8") from None


def _check(found: Mapping[str, Any]) -> Check:
    value = number(found["value"])
    if value is None and found["value"] is not None:
        raise TypeError(
            f"value: expected a finite number, got {quoted(found['value'])}"
        )
    return Check(**{**found, "value": math.nan if value is None else value})


def _origin(revision: Mapping[str, Any], machine: Mapping[str, Any]) -> str:
    commit = revision["describe"] or "unknown"
    changed = " with changes" if revision["dirty"] else ""
    return (
        f"revision {commit}{changed}; {machine['cpu']}, {machine['architecture']}, "
        f"{machine['cores']} cores, {machine['system']}; Python {machine['python']}, "
        f"NumPy {machine['numpy']}"
    )


def _bag_origin(folder: Path) -> str:
    """Revision and arguments inside the bag in `folder`, if there is one."""
    if not (folder / "metadata.yaml").is_file():
        return "revision not recorded"
    from slot_lab.bags.bag import Bag  # noqa: PLC0415 - heavy

    try:
        about = dict(Bag(folder).origin.about)
    except BagError as error:
        raise ReportError(error) from None
    revision = about.pop("revision", "not recorded")
    values = ", ".join(f"{name} {value}" for name, value in about.items() if value)
    return f"revision {revision}" + (f"; {values}" if values else "")


def _images(
    path: Path, name: str, captions: Mapping[str, str]
) -> list[tuple[Path, str]]:
    """Images beside a result: those with a caption first, in a folder of its own all others."""
    files = [path.parent / file for file in captions if (path.parent / file).is_file()]
    if path.parent.name == name:
        files += sorted(set(path.parent.glob("*.png")) - set(files))
    return [(file, captions.get(file.name, file.stem)) for file in files]


def _read_errors(path: Path) -> list[dict[str, Any]]:
    """Rows of the errors.csv of scripts/validate: point, axis, and numbers."""
    rows = []
    for row in csv.DictReader(_read_text(path).splitlines()):
        try:
            numbers = {
                k: float(v) for k, v in row.items() if k not in ("point", "axis")
            }
            labels = {"point": row["point"], "axis": row["axis"]}
        except (TypeError, ValueError, KeyError) as error:
            raise ReportError(
                f"{path}: not a table of scripts/validate: {error}"
            ) from None
        rows.append(labels | numbers)
    return rows
