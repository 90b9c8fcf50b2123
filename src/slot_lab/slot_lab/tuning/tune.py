"""Search of a stride on the simulated robot: its stages, and the file of `config/gait`."""

import argparse
import dataclasses
import functools
import json
import math
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from slot_core import config
from slot_core.command_line import ProgressLine
from slot_core.config import ConfigError
from slot_core.control.force_map import read_springs
from slot_core.gait.gait import Pattern, Steering, Stride, read_gaits
from slot_core.legs.fingerprint import fingerprint
from slot_core.refusal import quoted
from slot_core.robot import read_robot
from slot_lab.desk_command import Outcome
from slot_lab.tuning import identification
from slot_lab.tuning.identification import IdentificationError
from slot_lab.tuning.pattern_search import (
    Goal,
    PatternSearch,
    start_of,
    trial,
)
from slot_lab.tuning.stride_run import (
    RunAll,
    TuningSettings,
    read_tuning,
    simulate,
)
from slot_lab.workers import mapper

RECORDS = Path("results", "tune")
QUICK = {"friction": [0.4], "strides": 3, "evaluations": 32, "population": 8}
LEAST_SPEED = 1e-3  # m/s, rad/s, of a pattern
# of the forward speed at amplitude one that a stride is asked for by default: the policy has a rest
CRUISE_SHARE = 0.8
COMMENT_WIDTH = 98
DECIMALS = 9  # of written values; smaller ones are zero


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Search and write the stride; returns the lines of the report.

    Raises ConfigError, IdentificationError, ModuleNotFoundError, OSError.
    """
    tuning = Tuning(options, progress)
    with mapper(options.scheduler, options.workers) as run_all:
        return tuning.write(run_all), 0


class Tuning:
    """Search by `scripts/tune`: its options, settings and stages."""

    def __init__(
        self,
        options: argparse.Namespace,
        progress: ProgressLine,
        records: Path = RECORDS,
        searching: Mapping[str, Any] | None = None,
    ) -> None:
        """Read the configuration; raises ConfigError.

        records: directory of the searches' records. searching: settings that differ in searches.
        """
        self._options, self._robot = options, read_robot()
        self._records = records
        self._out: Path = (
            options.out or config.config_dir() / "gait" / f"{options.gait}.yaml"
        )
        self._settings = _settings(options)
        self._searching = config.replace(self._settings, searching or {})
        self.stride = _start(options)
        seed = options.seed if options.scratch else None
        self._starts = {  # before the first search: a later one may be refused
            kind: start_of(self.stride, kind, self._settings, seed)
            for kind in identification.NUMBERS
            if kind in options.stages
        }
        self._progress = progress

    def write(self, run_all: Callable[..., list[Any]]) -> list[str]:
        """Run the stages and write the stride; returns their figures, lines of text.

        run_all: of `mapper`. Raises IdentificationError, OSError.
        """
        simulated = functools.partial(
            run_all,
            functools.partial(
                simulate, settings=self._settings, robot=self._robot
            ),
        )
        notes: list[str] = []
        for stage in self._options.stages:
            notes += getattr(self, f"_{stage}")(simulated)
        write_gait(
            self._out,
            self.stride,
            [self._options.command, *notes],
            fingerprint(self._robot),
        )
        self.forget()
        return [*notes, str(self._out)]

    def forget(self) -> None:
        """Remove the records of the searches."""
        for kind in identification.NUMBERS:
            self._record(kind).unlink(missing_ok=True)

    def _forward(self, run_all: RunAll) -> list[str]:
        pattern, note = self._search("forward", run_all)
        across = identification.rows(
            identification.lateral(np.array(pattern.angle_deg))
        )
        self.stride = replace(
            self.stride,
            forward=pattern,
            lateral=replace(pattern, angle_deg=across),
        )
        return [note]

    def _turn(self, run_all: RunAll) -> list[str]:
        pattern, note = self._search("turn", run_all)
        self.stride = replace(self.stride, turn=pattern)
        return [note]

    def _search(self, kind: str, run_all: RunAll) -> tuple[Pattern, str]:
        search = PatternSearch(
            self.stride,
            Goal(kind, self._options.top),
            self._starts[kind],
            self._searching,
            self._options.seed,
        )
        found = search.run(run_all, self._record(kind), self._progress)
        if not np.mean(found.speed) >= LEAST_SPEED:
            raise IdentificationError(
                f"{kind}: no candidate moves; more evaluations are needed"
            )
        tried: Pattern = getattr(trial(self.stride, kind, found.x), kind)
        pattern = replace(tried, speed=float(np.mean(found.speed)))
        speeds = ", ".join(f"{v:.4f}" for v in found.speed)
        note = f"{kind}: {speeds} at {_floors(self._searching)}, open loop"
        return pattern, note

    def _steering(self, run_all: RunAll) -> list[str]:
        self._progress("steering")
        steering, change = identification.find_steering(
            self.stride, self._settings, run_all
        )
        if steering.rate < self._settings.steering_rate / 4:
            raise IdentificationError(
                f"steering: only {steering.rate:.4f} rad/s was found"
            )
        # a reflected left turn is a right turn
        across = -identification.lateral(np.array(steering.angle_deg))
        self.stride = replace(
            self.stride,
            forward_steering=steering,
            lateral_steering=Steering(
                steering.rate, steering.rate_max, identification.rows(across)
            ),
        )
        return [
            f"steering: {steering.rate:.4f} rad/s with v_y {change[0]:+.4f} m/s,"
            f" roll {np.degrees(change[2]):+.2f} deg"
        ]

    def _identify(self, run_all: RunAll) -> list[str]:
        self._progress("identify: patterns")
        tables: dict[str, Any] = identification.tabulate(
            self.stride, self._settings, run_all
        )
        for name, pattern in tables.items():
            if pattern.speed < LEAST_SPEED:
                raise IdentificationError(
                    f"{name}: {pattern.speed:.4f}, does not move on these legs"
                )
        most = math.floor(1e3 * CRUISE_SHARE * tables["forward"].speed) / 1e3
        self.stride = replace(
            self.stride, **tables, cruise=min(self.stride.cruise, most)
        )
        speeds = ", ".join(
            f"{name} {pattern.speed:.4f}"
            f" at {self.stride.height + pattern.height[0]:.3f} m"
            for name, pattern in tables.items()
        )
        return [
            f"speeds and heights at amplitude one, scene {self._settings.scene},"
            f" {_floors(self._settings)}: {speeds}; cruise {self.stride.cruise:g}"
        ]

    def _record(self, kind: str) -> Path:
        return self._records / f"{self._out.stem}.{kind}.jsonl"


def _floors(settings: TuningSettings) -> str:
    return "friction " + ", ".join(f"{value:g}" for value in settings.friction)


def _settings(options: argparse.Namespace) -> TuningSettings:
    given = {
        "evaluations": options.evaluations,
        "friction": options.friction,
        "tilt_deg": options.tilt,
        "scene": options.scene,
    }
    changes = dict(QUICK) if options.quick else {}
    changes |= {
        name: value for name, value in given.items() if value is not None
    }
    return config.replace(read_tuning(), changes, where="scripts/tune")


def _start(options: argparse.Namespace) -> Stride:
    """The stride to start from, at the height and period that are asked for."""
    name = options.like or options.gait
    stride = read_gaits().find(name)
    if not isinstance(stride, Stride):
        raise ConfigError(f"gait {quoted(name)} is a posture, not a stride")
    changes = {
        name: getattr(options, name)
        for name in ("height_range", "period", "cruise")
    }
    if options.height is not None:
        height = options.height
        share = read_robot().weight / 4  # N, of a leg at rest
        angle = read_springs().angle(np.array([share]), np.array([height]))[0]
        changes |= {
            "height": height,
            "centre_force": share,
            "centre_deg": [round(float(np.degrees(angle)), 1)] * 4,
            "height_range": options.height_range or [height] * 2,
        }
    given = {
        name: value for name, value in changes.items() if value is not None
    }
    return config.replace(stride, given, where="scripts/tune")


def write_gait(
    path: Path,
    stride: Stride,
    head: Sequence[str],
    made_for: Mapping[str, Any],
) -> None:
    """Write a stride; head: lines of the comment before it; made_for: its fingerprint.

    Raises OSError.
    """
    lines = [
        f"# {part}"
        for line in head
        for part in textwrap.wrap(line, COMMENT_WIDTH) or [""]
    ]
    values = json.loads(
        json.dumps(dataclasses.asdict(stride)),
        parse_float=lambda text: float(f"{round(float(text), DECIMALS):.4g}"),
    )
    ordered = sorted(values.items(), key=lambda item: isinstance(item[1], dict))
    content = {**dict(ordered), "made_for": {**made_for}}
    text = yaml.safe_dump(
        content, sort_keys=False, default_flow_style=None, width=COMMENT_WIDTH
    )
    path.write_text("\n".join([*lines, text]))
