"""Searches a stride on the simulated robot, identifies it and writes its file.

The stages, in this order (default: all):

    forward   search of the forward pattern; the lateral one is its reflection
    turn      search of the pattern that turns in place
    steering  change of the patterns that alters the yaw rate alone
    identify  speeds, normal forces and sway of every pattern

An interrupted search continues when the same command is given again.
"""

from __future__ import annotations

import argparse
import functools
import math
import shlex
import signal
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from slot_core import config
from slot_core.command_line import (
    INTERRUPTED,
    command_parser,
    positive_integer,
    refuse,
    show,
)
from slot_core.config import ConfigError
from slot_core.control.force_map import read_springs
from slot_core.gait.gait import Pattern, Steering, Stride, read_gaits
from slot_core.refusal import quoted
from slot_core.robot import read_robot
from slot_lab.tuning import gait_file, identification, symmetry
from slot_lab.tuning.identification import IdentificationError
from slot_lab.tuning.pattern_search import Goal, PatternSearch, bare_pattern, start_of
from slot_lab.tuning.settings import TuningSettings, read_tuning
from slot_lab.tuning.stride_run import RunAll, simulate
from slot_lab.workers import gather, workers

STAGES = ("forward", "turn", "steering", "identify")
RECORDS = Path("results", "tune")
QUICK = {"friction": [0.4], "strides": 3, "evaluations": 32, "population": 8}
LEAST_SPEED = 1e-3  # m/s, rad/s, of a pattern


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/tune`; returns the exit code."""
    options = _parser().parse_args(arguments)
    options.out = options.out or config.config_dir() / "gait" / f"{options.gait}.yaml"
    command = "scripts/tune " + shlex.join(sys.argv[1:] if arguments is None else arguments)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        tuning = _Tuning(options)
        call = functools.partial(simulate, settings=tuning.settings)
        with workers(options.scheduler, options.workers) as client:
            notes = tuning.run(functools.partial(gather, client, call))
        gait_file.write(options.out, tuning.stride, [command, *notes])
    except KeyboardInterrupt:
        print("\nscripts/tune: interrupted; the same command continues", file=sys.stderr)
        return INTERRUPTED
    except (ConfigError, IdentificationError, ModuleNotFoundError, OSError) as error:
        refuse("scripts/tune", error)
        return 2
    tuning.forget()
    return 0 if show("scripts/tune", [*notes, str(options.out)]) else 2


class _Tuning:
    """A run of `scripts/tune`: its options, settings and stages."""

    def __init__(self, options: argparse.Namespace) -> None:
        """Read the configuration; raises ConfigError."""
        self._options = options
        self.settings = _settings(options)
        self.stride = _start(options)
        self._stages = options.stages or STAGES
        seed = options.seed if options.scratch else None
        self._starts = {  # before the first search: a later one may be refused
            kind: start_of(self.stride, kind, self.settings, seed)
            for kind in symmetry.NUMBERS
            if kind in self._stages
        }
        self._progress = _Progress()

    def run(self, run_all: RunAll) -> list[str]:
        """Run the stages and return their figures, lines of text."""
        notes: list[str] = []
        for stage in STAGES:
            if stage in self._stages:
                notes += getattr(self, f"_{stage}")(run_all)
        return notes

    def forget(self) -> None:
        """Remove the records of searches that are written."""
        for kind in symmetry.NUMBERS:
            self._record(kind).unlink(missing_ok=True)

    def _forward(self, run_all: RunAll) -> list[str]:
        pattern, note = self._search("forward", run_all)
        across = symmetry.rows(symmetry.lateral(np.array(pattern.angle_deg)))
        self.stride = replace(
            self.stride, forward=pattern, lateral=replace(pattern, angle_deg=across)
        )
        return [note]

    def _turn(self, run_all: RunAll) -> list[str]:
        pattern, note = self._search("turn", run_all)
        self.stride = replace(self.stride, turn=pattern)
        return [note]

    def _search(self, kind: str, run_all: RunAll) -> tuple[Pattern, str]:
        goal = Goal(kind, self._options.top)
        start, seed = self._starts[kind], self._options.seed
        search = PatternSearch(self.stride, goal, start, self.settings, seed)
        found = search.run(run_all, self._record(kind), self._progress)
        angle = symmetry.forward(found.x) if kind == "forward" else symmetry.turn(found.x)
        if not np.mean(found.speed) >= LEAST_SPEED:
            raise IdentificationError(f"{kind}: no candidate moves; more evaluations are needed")
        pattern = replace(bare_pattern(angle), speed=float(np.mean(found.speed)))
        speeds = ", ".join(f"{v:.4f}" for v in found.speed)
        friction = ", ".join(f"{value:g}" for value in self.settings.friction)
        return pattern, f"{kind}: {speeds} at friction {friction}, open loop"

    def _steering(self, run_all: RunAll) -> list[str]:
        steering, change = identification.find_steering(self.stride, self.settings, run_all)
        if steering.rate < self.settings.steering_rate / 4:
            raise IdentificationError(f"steering: only {steering.rate:.4f} rad/s was found")
        across = symmetry.lateral_steering(np.array(steering.angle_deg))
        self.stride = replace(
            self.stride,
            forward_steering=steering,
            lateral_steering=Steering(steering.rate, steering.rate_max, symmetry.rows(across)),
        )
        stray = f"v_y {change[0]:+.4f} m/s, roll {np.degrees(change[2]):+.2f} deg"
        return [f"steering: {steering.rate:.4f} rad/s with {stray}"]

    def _identify(self, run_all: RunAll) -> list[str]:
        self._progress("identify: patterns")
        tables: dict[str, Any] = identification.tabulate(self.stride, self.settings, run_all)
        self.stride = replace(self.stride, **tables)
        speeds = ", ".join(f"{name} {getattr(self.stride, name).speed:.4f}" for name in tables)
        return [f"speeds at amplitude one: {speeds}"]

    def _record(self, kind: str) -> Path:
        return RECORDS / f"{self._options.out.stem}.{kind}.jsonl"


class _Progress:
    """Line of progress: rewritten in a terminal, else one every ten seconds."""

    INTERVAL = 10.0  # s

    def __init__(self) -> None:
        self._last = -math.inf  # s

    def __call__(self, line: str) -> None:
        if sys.stderr.isatty():
            print(f"\r{line:<78}", end="", file=sys.stderr, flush=True)
        elif (now := time.monotonic()) - self._last >= self.INTERVAL:
            self._last = now
            print(line, file=sys.stderr, flush=True)


def _settings(options: argparse.Namespace) -> TuningSettings:
    given = {
        "evaluations": options.evaluations, "friction": options.friction,
        "tilt_deg": options.tilt, "scene": options.scene,
    }  # fmt: skip
    changes = dict(QUICK) if options.quick else {}
    changes |= {name: value for name, value in given.items() if value is not None}
    return config.replace(read_tuning(), changes, where="scripts/tune")


def _start(options: argparse.Namespace) -> Stride:
    """The stride to start from, at the height and period that are asked for."""
    name = options.like or options.gait
    stride = read_gaits().find(name)
    if not isinstance(stride, Stride):
        raise ConfigError(f"gait {quoted(name)} is a posture, not a stride")
    changes: dict[str, object] = {}
    if options.height is not None:
        changes |= _rest(options.height) | {"height": options.height}
        changes["height_range"] = options.height_range or [options.height] * 2
    elif options.height_range:
        changes["height_range"] = options.height_range
    if options.period is not None:
        changes["period"] = options.period
    if options.cruise is not None:
        changes["cruise"] = options.cruise
    return config.replace(stride, changes, where="scripts/tune")


def _rest(height: float) -> dict[str, object]:
    """Centre of a stride at a height (m): tendon angles of legs that carry a quarter each."""
    angle = read_springs().angle(np.array([read_robot().weight / 4]), np.array([height]))[0]
    return {"centre_deg": [round(float(np.degrees(angle)), 1)] * 4}


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("tune", __doc__)
    add = parser.add_argument
    add("gait", metavar="NAME", help="name of the stride that is written")
    add("stages", nargs="*", metavar="STAGE", type=_stage, help=", ".join(STAGES))
    add("--like", metavar="NAME", help="stride to start from (default: the same)")
    add("--scratch", action="store_true", help="start the searches from a random pattern")
    add("--out", type=Path, metavar="FILE", help="default: config/gait/NAME.yaml")
    add(
        "--seed",
        metavar="N",
        type=positive_integer,
        default=1,
        help="seed of the searches (default: 1)",
    )
    add("--evaluations", type=int, metavar="N", help="candidates of a search")
    add("--friction", type=float, nargs="+", metavar="N", help="friction of the floors")
    add("--tilt", type=float, metavar="DEG", help="tilt RMS that costs nothing")
    add("--top", type=float, default=np.inf, metavar="M", help="height the torso stays below")
    add("--height", type=float, metavar="M", help="height of base_link")
    add("--height-range", type=float, nargs=2, metavar="M", help="heights that can be commanded")
    add("--period", type=float, metavar="S", help="duration of a stride")
    add("--cruise", type=float, metavar="M/S", help="v_x if none is requested, m/s")
    add("--scene", metavar="NAME", help="scene of config/scene; map is three times as fast")
    add("--scheduler", default="", metavar="ADDRESS", help="of dask; default: this machine")
    add("--workers", type=positive_integer, metavar="N", help="local processes (default: cores)")
    add("--quick", action="store_true", help="one floor, 32 candidates: a demonstration")
    return parser


def _stage(text: str) -> str:
    if text not in STAGES:
        raise argparse.ArgumentTypeError(f"{quoted(text)}: expected one of {', '.join(STAGES)}")
    return text


if __name__ == "__main__":
    sys.exit(main())
