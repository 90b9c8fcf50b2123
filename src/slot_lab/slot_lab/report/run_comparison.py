"""Comparison of two runs: their origins, every figure of their summaries, their motion."""

import argparse
import fnmatch
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure as Canvas

from slot_core import config
from slot_core.arrays import Array
from slot_core.command_line import ProgressLine
from slot_core.config import ConfigError
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.drawing import palette
from slot_core.dynamics.servo import read_servo
from slot_core.geometry import rotate
from slot_core.recording.origin import CONFIGURATION
from slot_core.recording.record_settings import BagError, read_record_settings
from slot_core.refusal import InputError, one_line, quoted
from slot_lab.bags.bag import Bag
from slot_lab.bags.recorded_walk import TorsoTrack, read_motion
from slot_lab.bags.topics import PLANS
from slot_lab.desk_command import Outcome, write_plot
from slot_lab.report.metrics import UNITS, Figure, figures, walk_metrics

NAME_WIDTH, VALUE_WIDTH = 29, 14
DPI = 100
WIDTH = 24  # of the names
Files = Mapping[str, bytes]  # by name


class CompareError(InputError):
    """Two runs cannot be compared as asked; the message is one line."""


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Compare two bags; exit code 1 if a figure is beyond its tolerance.

    Raises BagError, CompareError, OSError.
    """
    progress("opening the bags")
    bags = [Bag(path, options.namespace) for path in options.bags]
    warm_up = options.warm_up
    if warm_up is None:
        warm_up = read_record_settings().warm_up
    walks = []
    for bag in bags:
        progress(f"figures of {bag.path}")
        walks.append(walk_metrics(bag, warm_up, read_servo()))
    pairs = compare_figures(*map(figures, walks))
    beyond = exceeded(pairs, options.tolerance)
    columns = ("first", "second", "difference")
    named = list(zip(columns, bags))
    sources = dict.fromkeys(walk.source for walk in walks)
    lines = [
        *(f"{which:<8}{bag.path}" for which, bag in named),
        *(f"{which:<8}{bag.remark}" for which, bag in named if bag.remark),
        "",
        *origin_lines(*bags),
        "",
        f"motion from {' -> '.join(sources)}",
        f"after {warm_up:g} s of warm-up",
        f"{'':<{NAME_WIDTH}}"
        + "".join(f"{name:>{VALUE_WIDTH}}" for name in columns),
        *map(str, pairs),
        *beyond,
    ]
    if options.plot:
        progress("drawing")
        write_plot(plot(*bags), options.plot, DPI)
    return lines, 1 if beyond else 0


@dataclass(frozen=True)
class FigurePair:
    """A figure of both runs."""

    first: Figure
    second: Figure

    @property
    def unknown(self) -> bool:
        """Whether neither bag has it."""
        return math.isnan(self.first.value) and math.isnan(self.second.value)

    @property
    def difference(self) -> float:
        """Second minus first; zero where neither is known, infinite where only one is."""
        if self.unknown:
            return 0.0
        difference = self.second.value - self.first.value
        return math.inf if math.isnan(difference) else difference

    def __str__(self) -> str:
        numbers = (self.first.value, self.second.value)
        cells = (f"{n:.6g}" if math.isfinite(n) else "-" for n in numbers)
        values = "".join(f"{cell:>{VALUE_WIDTH}}" for cell in cells)
        off = self.difference
        known = f"{off:+.4g}" if off else "="
        change = known if math.isfinite(off) and not self.unknown else ""
        return f"{self.first.name:<{NAME_WIDTH}}{values}{change:>{VALUE_WIDTH}} {self.first.unit}"


def compare_figures(
    first: Sequence[Figure], second: Sequence[Figure]
) -> list[FigurePair]:
    """The figures of two walks in pairs; a figure that one lacks, such as a stage, is a NaN."""
    a, b = ({figure.name: figure for figure in run} for run in (first, second))
    missing = {
        name: Figure(name, math.nan, figure.unit)
        for name, figure in {**a, **b}.items()
    }
    return [
        FigurePair(a.get(name, unknown), b.get(name, unknown))
        for name, unknown in missing.items()
    ]


def exceeded(
    pairs: Sequence[FigurePair], tolerances: Sequence[tuple[str, float]]
) -> list[str]:
    """A line on each figure beyond its tolerance: the last that matches its name.

    tolerances: patterns of a shell for names, with the largest difference in their unit.
    Raises CompareError for a tolerance that matches no figure that is known of a run.
    """
    known = [p.first.name for p in pairs if not p.unknown]
    for pattern, largest in tolerances:
        if not fnmatch.filter(known, pattern):
            raise CompareError(
                f"--tolerance {pattern}={largest:g}: the bags hold no such figure of"
                f" {', '.join(UNITS)}"
            )
    lines = []
    for pair in pairs:
        name, unit, off = pair.first.name, pair.first.unit, pair.difference
        limits = [
            n for pattern, n in tolerances if fnmatch.fnmatchcase(name, pattern)
        ]
        if limits and abs(off) > limits[-1]:
            change, most = (
                f"{text} {unit}".rstrip()
                for text in (f"{off:+.4g}", f"{limits[-1]:g}")
            )
            reason = (
                f"{change}, more than {most}"
                if math.isfinite(off)
                else "is in one bag only"
            )
            lines.append(f"beyond the tolerance: {name} {reason}")
    return lines


def plot(first: Bag, second: Bag) -> Canvas:
    """A row for each curve: both walks, and second minus first while both last."""
    walks = [read_motion(bag) for bag in (first, second)]
    times = [walk.t - walk.t[0] for walk in walks]
    a, b = (curves(walk) for walk in walks)
    figure = Canvas(figsize=(12.0, 1.9 * len(a)), dpi=DPI, layout="constrained")
    axes = figure.subplots(len(a), 2, sharex=True)
    shared = times[0][times[0] <= times[1][-1]]
    for (both, difference), (title, then), now in zip(
        axes, a.items(), b.values()
    ):
        both.plot(
            times[0], then, color=palette.TRUE, lw=1.4, label=first.path.name
        )
        both.plot(
            times[1],
            now,
            color=palette.SECONDARY,
            lw=1.0,
            label=second.path.name,
        )
        difference.plot(
            shared,
            np.interp(shared, times[1], now) - then[: len(shared)],
            color=palette.INK,
            lw=1.0,
        )
        both.set_ylabel(title)
        for ax in (both, difference):
            ax.grid(color=palette.PALE, lw=0.5)
    axes[0, 0].set_title("both runs")
    axes[0, 1].set_title("second - first")
    axes[0, 0].legend(frameon=False)
    for ax in axes[-1]:
        ax.set_xlabel("time since the start of each bag (s)")
    return figure


def curves(walk: TorsoTrack) -> Mapping[str, Array]:
    """Curves of the torso (n,) by title, in the frame of its place and heading at the start."""
    heading = walk.rpy[0, 2]
    forward, left = rotate(
        walk.position[:, :2] - walk.position[0, :2], -heading
    ).T
    return {
        "forward (m)": forward,
        "left (mm)": 1e3 * left,
        "height (mm)": 1e3 * walk.position[:, 2],
        "speed (m/s)": walk.heading_velocity[:, 0],
        "roll (deg)": np.degrees(walk.rpy[:, 0]),
        "pitch (deg)": np.degrees(walk.rpy[:, 1]),
        "yaw (deg)": np.degrees(walk.rpy[:, 2] - heading),
    }


def origin_lines(first: Bag, second: Bag) -> list[str]:
    """Lines on revision, policy and other differences of the origins; raises BagError."""
    a, b = _about(first), _about(second)
    names = dict.fromkeys(["revision", "policy", *a, *b])
    shown = [
        name
        for name in names
        if name in ("revision", "policy") or a.get(name) != b.get(name)
    ]
    lines = [_line(name, a.get(name, "-"), b.get(name, "-")) for name in shown]
    if same := ", ".join(
        f"{name} {a[name]}" for name in names if name not in shown
    ):
        lines.append(_line("the same", same, same))
    tuned = _tuned(first), _tuned(second)
    if tuned[0] != tuned[1]:
        lines.append(
            _line("changed in the run", *(text or "nothing" for text in tuned))
        )
    then, now = dict(first.origin.files), dict(second.origin.files)
    recorded = [
        files.pop(CONFIGURATION, None) is not None for files in (then, now)
    ]
    lines += [_file_line(name, then, now) for name in _differing(then, now)]
    if not all(recorded):
        return [
            *lines,
            _line(
                "configuration",
                *("recorded" if has else "not recorded" for has in recorded),
            ),
        ]
    values = [*_value_lines(_configuration(first), _configuration(second))]
    return lines + (values or [_line("configuration", "the same", "the same")])


def _about(bag: Bag) -> dict[str, str]:
    """Revision and arguments; the policy is the default one where none is named."""
    about = dict(bag.origin.about)
    return ({"policy": DEFAULT_POLICY} | about) if about else {}


def _line(name: str, then: str, now: str) -> str:
    change = then if then == now else f"{then} -> {now}"
    return f"{one_line(name):<{WIDTH}}{one_line(change)}"


def _tuned(bag: Bag) -> str:
    """Settings changed while the policy ran, in the order of time."""
    if not bag.counts.get(PLANS):
        return ""
    with bag.using(PLANS):
        texts = dict.fromkeys(
            getattr(message, "settings", "")
            for _, message in bag.messages(PLANS)
        )
        return "; ".join(
            f"{name} {quoted(value)}"
            for text in filter(None, texts)
            for name, value in json.loads(text).items()
        )


def _differing(then: Files, now: Files) -> list[str]:
    """Names of the files that only one bag has, or that differ."""
    return [
        name
        for name in sorted(then.keys() | now.keys())
        if then.get(name) != now.get(name)
    ]


def _file_line(name: str, then: Files, now: Files) -> str:
    """Line on a file that differs."""
    if name in then and name in now:
        return _line(name, "one file", "another one")
    return _line(
        name, *("a file" if name in files else "-" for files in (then, now))
    )


def _configuration(bag: Bag) -> Files:
    try:
        return bag.origin.configuration()
    except BagError as error:
        raise BagError(f"{bag.path}: {error}") from None


def _value_lines(then: Files, now: Files) -> Iterator[str]:
    """Lines on the values of the configuration that differ."""
    for file in _differing(then, now):
        try:
            before, after = (
                _values(files[file], file) for files in (then, now)
            )
        except (KeyError, BagError, ConfigError, UnicodeDecodeError):
            yield _file_line(file, then, now)
            continue
        names = dict.fromkeys([*before, *after])
        changed = [
            name for name in names if before.get(name) != after.get(name)
        ]
        for name in changed:
            texts = (
                quoted(v[name]) if name in v else "-" for v in (before, after)
            )
            yield f"{file} {name}  {' -> '.join(texts)}"
        if not changed:
            yield f"{file:<{WIDTH}}other comments"


def _values(content: bytes, file: str) -> dict[str, Any]:
    """Values of a YAML file by dotted name; raises ConfigError if it is no mapping."""
    found = config.parse(content.decode()) if file.endswith(".yaml") else None
    if not isinstance(found, Mapping):
        raise ConfigError(f"{file}: no mapping")
    return dict(config.dotted(found))
