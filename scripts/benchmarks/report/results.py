"""Results of benchmarks and runs: read from their files, each with the command behind it."""

import csv
import json
import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.harness import Check, known
from slot_core.recording.record_settings import BagError
from slot_core.refusal import InputError, quoted

CAPTIONS = {
    "rod.png": "speed against error of the public rod, MuJoCo and PyElastica",
    "robot.png": "speed against error of the whole robot",
    "other_engine.png": "speeds of the gaits here and in MuJoCo",
    "mpc.png": "speed against error of the solver",
    "estimation.png": "error of the state over the delay of the odometry",
    "table.png": "ten rows: error of each policy, and the goal",
    "velocity.png": "commanded and achieved velocity in all directions",
    "top.png": "square and 60 deg path from above",
    "margins.png": "the walk over friction and the servos' supply voltage",
    "perturbations.png": "maximum cost beside the paper's, motion of the robot",
    "graph.png": "latency of the nodes",
    "servo_step.png": "a step of an emulated servo",
    "walk.png": "path, height, velocities, tilt, tendon angles, forces and latencies of the run",
    "constraint_map.png": "constraint map: slack of every constraint over time; red is violated",
    "leg.png": "height of four points of a leg: simulated, and a synthetic measurement",
    "torso.png": "the torso: predicted by the model, and a synthetic measurement",
}
"""Captions of images by the names of their files; others stand with their name."""

EXAMPLE = "slot_bringup/example"
MAP = "scripts/view --map {} --out {}/constraint_map.png"
RUNS = {
    "walk": ("Walk", "scripts/run --lockstep --bag {}", MAP),
    "crawl": ("Crawl", "scripts/run --lockstep --gait crawl --bag {}", MAP),
    "diagonal": (
        "Walk at 60 degrees",
        "scripts/run --lockstep --vx 0.025 --vy 0.043 --bag {}",
        MAP,
    ),
    "single_leg": (
        "Single leg, compared with the synthetic example",
        f"scripts/validate {EXAMPLE}/single_leg_run.csv {EXAMPLE}/single_leg_markers.csv"
        " --out {}",
    ),
    "walk_validated": (
        "Walk, compared with the synthetic example",
        f"scripts/twin {EXAMPLE}/walk --out {{}}",
        f"scripts/validate {{}}/predicted.csv {EXAMPLE}/walk_markers.csv --frame-time 1.5"
        " --out {}",
    ),
}
"""Title and command lines of runs by folder of the results, for which {} stands."""


class ReportError(InputError):
    """A result that cannot be read, or a report that cannot be written; the message is one line."""


@dataclass(frozen=True)
class Result:
    """Result of a command, read from its directory."""

    command: str
    origin: str  # revision and machine, or what is known of them
    rows: Sequence[Mapping[str, Any]]
    images: Sequence[Path]
    checks: Sequence[Check] = ()
    quick: bool = False
    text: str = ""  # summary


@dataclass(frozen=True)
class ReportSection:
    """A benchmark or a run on the page: its subject, its commands and its result, if there is one."""

    about: str
    commands: Sequence[str]
    result: Result | None


def read_benchmarks(directory: Path) -> dict[str, ReportSection]:
    """All benchmarks by name; raises ReportError for a file that scripts/bench did not write."""
    return {
        name: ReportSection(
            about,
            [
                shlex.join(
                    ["scripts/bench", name, "--out", str(directory / name)]
                )
            ],
            read_benchmark(directory, name),
        )
        for name, about in known().items()
    }


def read_runs(directory: Path) -> dict[str, ReportSection]:
    """All runs by folder; raises ReportError for a damaged bag or table."""
    found = {}
    for name, (title, *lines) in RUNS.items():
        folder = directory / name
        commands = [
            line.replace("{}", shlex.quote(str(folder))) for line in lines
        ]
        found[name] = ReportSection(
            title, commands, read_run(folder, "\n".join(commands))
        )
    return found


def read_benchmark(directory: Path, name: str) -> Result | None:
    """`directory/name/name.json` with its images; None if not there.

    Raises ReportError for a file that scripts/bench did not write so.
    """
    path = directory / name / f"{name}.json"
    if not path.is_file():
        return None
    try:
        found = json.loads(_read_text(path))
        if found["name"] != name:
            raise ValueError(
                f"name: expected {name!r}, got {quoted(found['name'])}"
            )
        return Result(
            f"scripts/bench {name}{' --quick' * found['quick']}",
            _origin(found["revision"], found["machine"]),
            [dict(row) for row in found["rows"]],
            sorted(path.parent.glob("*.png")),
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


def read_run(folder: Path, command: str) -> Result | None:
    """Result of a run in its folder; None without images. Raises ReportError."""
    images = sorted(folder.glob("*.png"))
    if not images:
        return None
    summary = folder / "summary.txt"
    text = _read_text(summary) if summary.is_file() else ""
    return Result(
        command,
        _bag_origin(folder),
        _read_errors(folder / "errors.csv"),
        images,
        text=text,
    )


def number(value: Any) -> float | None:
    """`value` if it is a finite number; else None, as where a benchmark found none."""
    numeric = isinstance(value, (int, float)) and not isinstance(value, bool)
    return (
        float(value) if numeric and abs(value) <= sys.float_info.max else None
    )


def _read_text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError as error:
        raise ReportError(f"{path}: {error.strerror}") from None
    except UnicodeDecodeError:
        raise ReportError(f"{path}: not text in UTF-8") from None


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
    values = [f"{name} {value}" for name, value in about.items() if value]
    return "; ".join([f"revision {revision}", *values])


def _read_errors(path: Path) -> list[dict[str, Any]]:
    """Rows of the errors.csv of scripts/validate, if it is there: point, axis, and numbers."""
    if not path.is_file():
        return []
    try:
        return [
            {
                k: v if k in ("point", "axis") else float(v)
                for k, v in row.items()
            }
            for row in csv.DictReader(_read_text(path).splitlines())
        ]
    except (TypeError, ValueError) as error:
        raise ReportError(
            f"{path}: not a table of scripts/validate: {error}"
        ) from None
