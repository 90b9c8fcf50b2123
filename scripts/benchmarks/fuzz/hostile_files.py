"""Mutated files of config/, and values known to be wrong in the place of good ones."""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.fuzz.outcomes import Outcomes
from slot_core import config
from slot_core.config import ConfigError
from slot_core.control.force_map import read_force_map
from slot_core.control.place_feedback import PlaceFeedback
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.settings import read_settings as read_dynamixel
from slot_core.estimation.state_estimator import read_estimator
from slot_core.gait.gait import read_gaits
from slot_core.mpc.settings import read_mpc
from slot_core.paper.numbers import read_paper
from slot_core.predictive.settings import read_predictive
from slot_core.recording.record_settings import read_record_settings
from slot_core.robot import read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.servos.registry import read_servo_bus
from slot_core.vision.settings import read_vision
from slot_lab.calibration.experiments import read_settings as read_experiments
from slot_lab.tuning.settings import read_tuning
from slot_lab.twin.settings import read_twin

BOMB = "a0: &a0 [1]\n" + "".join(
    f"a{n + 1}: &a{n + 1} [{', '.join([f'*a{n}'] * 9)}]\n" for n in range(8)
)
TOKENS = (
    "!!timestamp zz", "!!bool x", "!!python/name:os.system ''", "&a [*a]", "*a", "<<: {a: 1}",
    ".inf", ".nan", "-.inf", "1e999", "9" * 400, "0x" + "f" * 9000, "2001-99-99", "[" * 200,
    "{" * 50, "? [1]", '"\\e]0;x\\a"', "\x00", "\x1b[2J", "x" * 20000, "=", "~", "''", "[]", "{}",
    "- 1", "%TAG", "|", ">", "@", "`", "\t", "\ufeff", "\u202e", "1:2:3", "._", "0o8",
    "1__", "true", "null",
)  # fmt: skip
"""Contents put into a file, or in the place of a value."""
WRONG = ("much", math.nan, [1, 2, 3, 4, 5, 6, 7], {"a": 1}, None, True, "\x1b]0;x\x07", 10**400)
"""None of them is a number."""

Reader = Callable[[], Any]
READERS: Mapping[str, Reader] = {
    "calibration": read_experiments,
    "dynamixel": read_dynamixel,
    "emulator": read_emulator,
    "estimator": read_estimator,
    "force_map": read_force_map,
    "gait": read_gaits,
    "mpc": read_mpc,
    "paper": read_paper,
    "place": lambda: PlaceFeedback.read_settings("place"),
    "predictive": read_predictive,
    "record": read_record_settings,
    "robot": read_robot,
    "servo": read_servo,
    "servo_bus": read_servo_bus,
    "supervisor": read_supervisor,
    "tune": read_tuning,
    "twin": read_twin,
    "vision": read_vision,
}
"""By the file that they read."""


def reader_of(path: Path) -> Reader | None:
    """Reader of a file of config/, by its path there; None for a file that a command writes."""
    folder, name = path.parent.name, path.stem
    of_folder: dict[str, Reader] = {
        "gait": read_gaits,
        "mpc": lambda: read_mpc(name),
        "parameters": lambda: (read_robot(name), read_servo(name)),
        "scene": lambda: read_scene(name),
        "solver": lambda: [read_scene(scene) for scene in ("flat", "map", "paper")],
    }
    return of_folder.get(folder) or READERS.get(name)


def fuzz(count: int, rng: np.random.Generator) -> Outcomes:
    """Count mutated files, and as many values known to be wrong."""
    tally = Outcomes()
    with own_config() as root:
        files = [path.relative_to(root) for path in sorted(root.rglob("*.yaml"))]
        files = [path for path in files if reader_of(path)]
        for number in range(count):
            path = files[number % len(files)]
            original = (root / path).read_bytes()
            (root / path).write_bytes(mutate(original, rng))
            tally.call(str(path), reader_of(path), ConfigError)  # type: ignore[arg-type]
            (root / path).write_bytes(original)
    for name, call in wrong_values(count, rng):
        tally.call(name, call, ConfigError, wrong=True)
    return tally


@contextmanager
def own_config() -> Iterator[Path]:
    """A copy of config/ that is in force in the block."""
    before = os.environ.get("SLOT_CONFIG")
    with tempfile.TemporaryDirectory() as scratch:
        copy = Path(shutil.copytree(config.config_dir(), Path(scratch, "config")))
        os.environ["SLOT_CONFIG"] = str(copy)
        try:
            yield copy
        finally:
            if before is None:
                del os.environ["SLOT_CONFIG"]
            else:
                os.environ["SLOT_CONFIG"] = before


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """A file with a value replaced, a token inserted, bytes changed, lines doubled, or cut off."""
    lines, kind = data.splitlines(keepends=True), rng.integers(6)
    where, token = int(rng.integers(len(lines))), TOKENS[int(rng.integers(len(TOKENS)))].encode()
    if kind < 2:
        head, colon, _ = lines[where].partition(b": ")
        lines[where] = head + colon + token + b"\n"
    elif kind == 2:
        lines.insert(where, token + b"\n")
    elif kind == 3:
        lines.insert(where, lines[int(rng.integers(len(lines)))])
    elif kind == 4:
        return BOMB.encode() + data if rng.random() < 0.1 else data[: int(rng.integers(len(data)))]
    else:
        out = bytearray(data)
        for _ in range(rng.integers(1, 5)):
            out[rng.integers(len(out))] = int(rng.integers(256))
        return bytes(out)
    return b"".join(lines)


def wrong_values(count: int, rng: np.random.Generator) -> Iterator[tuple[str, Reader]]:
    """Settings with a number out of its range or with what is none, each by its name."""
    settings = [read() for read in READERS.values()] + [read_scene("flat")]
    numbers = [
        (one, name, value, meta)
        for one in settings
        for name, value, meta in config.leaves(one)
        if "low" in meta and not (isinstance(value, tuple) and not value)
    ]
    for _ in range(count):
        one, name, value, meta = numbers[int(rng.integers(len(numbers)))]
        bounds = [b for b in (meta["low"], meta["high"]) if math.isfinite(b)]
        wrong = WRONG[int(rng.integers(len(WRONG)))]
        if bounds and rng.random() < 0.5:
            bound = bounds[int(rng.integers(len(bounds)))]
            wrong = bound + math.copysign(1.0 + abs(bound), 1 if bound == meta["high"] else -1)
        if isinstance(value, tuple):
            wrong = (wrong, *value[1:])
        yield name, lambda one=one, name=name, wrong=wrong: config.replace(one, {name: wrong})
