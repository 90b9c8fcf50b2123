"""Reference of configuration and benchmark results, as Markdown."""

from __future__ import annotations

import dataclasses
import inspect
import json
import math
import typing
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.report.results import bench_command
from documentation.markdown import ROOT, code, format_value, link, plain, table
from slot_core import config
from slot_core.control.force_map import ForceMapSettings
from slot_core.control.place_feedback import PlaceSettings
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.settings import read_settings
from slot_core.estimation.state_estimator import read_estimator
from slot_core.gait.gait import read_gaits
from slot_core.legs.leg_map import LegMapSettings
from slot_core.mpc.settings import read_mpc
from slot_core.paper.numbers import PaperSettings
from slot_core.predictive.settings import read_predictive
from slot_core.recording.record_settings import RecordSettings
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.servos.registry import read_servo_bus
from slot_core.vision.settings import VisionSettings
from slot_lab.calibration.experiments import ExperimentSettings
from slot_lab.tuning.settings import TuningSettings
from slot_lab.twin.settings import TwinSettings

# Settings of each file of `config/`; of a scene and of the gaits one class serves many files.
SETTINGS: dict[str, Callable[[], Any]] = {
    "robot.yaml": read_robot,
    "scene/flat.yaml": partial(read_scene, "flat"),
    "servo.yaml": read_servo,
    "estimator.yaml": read_estimator,
    "gait.yaml": read_gaits,
    "predictive.yaml": read_predictive,
    "place.yaml": partial(config.read, PlaceSettings, "place"),
    "mpc.yaml": read_mpc,
    "mpc/paper_code.yaml": partial(read_mpc, "paper_code"),
    "force_map.yaml": partial(config.read, ForceMapSettings, "force_map"),
    "supervisor.yaml": read_supervisor,
    "servo_bus.yaml": read_servo_bus,
    "dynamixel.yaml": read_settings,
    "emulator.yaml": read_emulator,
    "vision.yaml": partial(config.read, VisionSettings, "vision"),
    "record.yaml": partial(config.read, RecordSettings, "record"),
    "leg_map.yaml": partial(config.read, LegMapSettings, "leg_map"),
    "tune.yaml": partial(config.read, TuningSettings, "tune"),
    "twin.yaml": partial(config.read, TwinSettings, "twin"),
    "calibration.yaml": partial(config.read, ExperimentSettings, "calibration"),
    "paper.yaml": partial(config.read, PaperSettings, "paper"),
}


def configuration() -> str:
    """Every value of `config/`: name, value as shipped, unit, bounds and meaning."""
    return "\n".join(_file(name, read()) for name, read in SETTINGS.items())


def _file(name: str, settings: Any) -> str:
    kind = type(settings)
    where = link(f"`{kind.__name__}`", Path(inspect.getfile(kind)).resolve())
    rows = [
        (f"`{dotted}`", code(value), plain(meta.get("unit", "")), bounds(meta), plain(meta["doc"]))
        for dotted, value, meta in leaves(kind, settings)
    ]
    return (
        f"## {name}\n\n{link(f'`config/{name}`', ROOT / 'config' / name)}, read into {where}\n\n"
        + table(("name", "shipped", "unit", "bounds", "meaning"), rows)
    )


def leaves(
    kind: type, settings: Any, prefix: str = ""
) -> Iterator[tuple[str, Any, Mapping[str, Any]]]:
    """Yield (dotted name, shipped value, metadata) of every value of a settings class.

    NAME stands for the names of a mapping, `[]` for the elements of a sequence of settings; their
    values are left out.
    """
    hints = typing.get_type_hints(kind)
    for field in dataclasses.fields(kind):
        name, hint = prefix + field.name, hints[field.name]
        value = getattr(settings, field.name, None)
        inner, suffix = _element(hint)
        if dataclasses.is_dataclass(inner):
            value = None if suffix else value
            yield from leaves(typing.cast(type, inner), value, f"{name}{suffix}.")
        else:
            yield name, None if isinstance(value, dict) else value, field.metadata


def _element(hint: Any) -> tuple[Any, str]:
    """Type of the elements of a mapping or a sequence, and how a name says so; else the type."""
    if typing.get_origin(hint) is dict:
        return typing.get_args(hint)[1], ".NAME"
    if typing.get_origin(hint) is tuple:
        return typing.get_args(hint)[0], "[]"
    return hint, ""


def bounds(meta: Mapping[str, Any]) -> str:
    """Bounds or options of a value from the metadata of its field."""
    if "options" in meta:
        return ", ".join(f"`{option}`" for option in meta["options"])
    low, high = meta.get("low", -math.inf), meta.get("high", math.inf)
    ends = {(True, True): f"{low:g} to {high:g}", (True, False): f"at least {low:g}",
            (False, True): f"at most {high:g}", (False, False): ""}  # fmt: skip
    return ends[math.isfinite(low), math.isfinite(high)]


def settings_classes() -> set[type]:
    """The dataclasses whose values the reference of the configuration lists."""
    found: set[type] = set()

    left = [type(read()) for read in SETTINGS.values()]
    while left:
        kind = left.pop()
        found.add(kind)
        inner = [_element(hint)[0] for hint in typing.get_type_hints(kind).values()]
        left += filter(dataclasses.is_dataclass, inner)
    return found


def results() -> str:
    """Checks and rows of every `results/NAME/NAME.json` that scripts/bench has written here.

    Raises ValueError for a file that is not JSON.
    """
    files = sorted((ROOT / "results").glob("*/*.json"))
    found = [path for path in files if path.stem == path.parent.name]
    if not found:
        names = sorted(p.parent.name for p in (ROOT / "scripts/benchmarks").glob("*/benchmark.py"))
        return (
            "This site was built without results. `scripts/bench NAME` writes "
            f"`results/NAME/NAME.json`; NAME is one of {', '.join(names)}.\n"
        )
    return "\n".join(_result(_load(path)) for path in found)


def _load(path: Path) -> Any:
    """Content of a result's file; raises ValueError, which names the file."""
    try:
        return json.loads(path.read_text())
    except ValueError as error:
        raise ValueError(f"{path.relative_to(ROOT)}: {error}") from None


def _result(result: Mapping[str, Any]) -> str:
    revision, machine = result["revision"], result["machine"]
    version = f"{plain(str(revision['describe']))}{', with changes' if revision['dirty'] else ''}"
    command = bench_command(result["name"], result["quick"], result["options"])
    checks = [
        ("holds" if c["holds"] else "**missed**", plain(c["name"]), _number(c["value"]),
         plain(c["unit"]), plain(c["goal"]))
        for c in result["checks"]
    ]  # fmt: skip
    return (
        f"## {result['name']}\n\n`{command}`, revision {version}, "
        f"{plain(machine['cpu'])}, {machine['cores']} cores, Python {machine['python']}\n\n"
        + table(("", "check", "value", "unit", "goal"), checks)
        + "".join(f"\n{part}" for part in _rows(result["rows"]))
    )


def _rows(rows: list[Mapping[str, Any]]) -> Iterator[str]:
    """One table for each set of columns."""
    for columns in dict.fromkeys(tuple(row) for row in rows):
        cells = [[_number(row[name]) for name in columns] for row in rows if tuple(row) == columns]
        yield table([plain(name) for name in columns], cells)


def _number(value: Any) -> str:
    """A value with four digits."""
    return plain(f"{value:.4g}" if isinstance(value, float) else format_value(value))
