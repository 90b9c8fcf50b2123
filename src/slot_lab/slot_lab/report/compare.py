"""Compares two runs: their origins, and every figure of their summaries side by side.

First what differs in revision, policy, arguments, attached files and the values of the
configuration, then the figures, named as in `walk_metrics`: those of the first bag, those of the
second, and second minus first. A dash stands where a bag lacks the data.
"""

from __future__ import annotations

import argparse
import fnmatch
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from slot_core.command_line import command_parser, show, within
from slot_core.progress import ProgressLine
from slot_core.refusal import InputError, quoted

if TYPE_CHECKING:
    from slot_lab.bags.bag import Bag
    from slot_lab.report.figures import Figure

EXIT_CODES = """\
Exit code: 0, 1 where a difference exceeds a tolerance, 2 unusable input.
"""
NAME_WIDTH, VALUE_WIDTH = 29, 14
SUFFIXES = (".png", ".pdf", ".svg")  # of a plot


class CompareError(InputError):
    """Two runs cannot be compared as asked; the message is one line."""


@dataclass(frozen=True)
class Tolerance:
    """Largest difference of the figures whose name matches a pattern, in their unit."""

    pattern: str  # as of a shell
    largest: float

    def __str__(self) -> str:
        return f"{self.pattern}={self.largest:g}"


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
        values = "".join(
            f"{_number(f.value):>{VALUE_WIDTH}}" for f in (self.first, self.second)
        )
        off = self.difference
        known = f"{off:+.4g}" if off else "="
        change = known if math.isfinite(off) and not self.unknown else ""
        return f"{self.first.name:<{NAME_WIDTH}}{values}{change:>{VALUE_WIDTH}} {self.first.unit}"


def compare_figures(
    first: Sequence[Figure], second: Sequence[Figure]
) -> list[FigurePair]:
    """The figures of two walks in pairs; a figure that one lacks, such as a stage, is a NaN."""
    from slot_lab.report.figures import Figure  # noqa: PLC0415 - heavy

    a, b = ({figure.name: figure for figure in run} for run in (first, second))
    units = {name: figure.unit for name, figure in {**a, **b}.items()}
    missing = {name: Figure(name, math.nan, unit) for name, unit in units.items()}
    return [FigurePair(a.get(n, missing[n]), b.get(n, missing[n])) for n in units]


def exceeded(pairs: Sequence[FigurePair], tolerances: Sequence[Tolerance]) -> list[str]:
    """A line on each figure beyond its tolerance: the last one that matches its name.

    Raises CompareError for a tolerance that matches no figure that is known of a run.
    """
    from slot_lab.report.figures import UNITS  # noqa: PLC0415 - heavy

    known = [p.first.name for p in pairs if not p.unknown]
    for tolerance in tolerances:
        if not fnmatch.filter(known, tolerance.pattern):
            names = ", ".join(UNITS)
            raise CompareError(
                f"--tolerance {tolerance}: the bags hold no such figure of {names}"
            )
    lines = []
    for pair in pairs:
        name, unit = pair.first.name, pair.first.unit
        limits = [t for t in tolerances if fnmatch.fnmatchcase(name, t.pattern)]
        if limits and abs(pair.difference) > limits[-1].largest:
            most = f", more than {limits[-1].largest:g} {unit}".rstrip()
            change = f"{pair.difference:+.4g} {unit}".rstrip() + most
            change = change if math.isfinite(pair.difference) else "is in one bag only"
            lines.append(f"beyond the tolerance: {name} {change}")
    return lines


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/compare`; ends with exit code 2 and one line on a bad input."""
    parser = _parser()
    options = parser.parse_args(arguments)
    from slot_lab.bags.bag import Bag  # noqa: PLC0415 - heavy
    from slot_lab.report.compare_plot import draw  # noqa: PLC0415

    try:
        if options.plot and options.plot.suffix not in SUFFIXES:
            raise CompareError(
                f"{options.plot}: the name of a plot ends in {', '.join(SUFFIXES)}"
            )
        with ProgressLine(parser.prog) as progress:
            progress("opening the bags")
            first, second = (Bag(path, options.namespace) for path in options.bags)
            lines, beyond = _compare((first, second), options, progress)
            if options.plot:
                progress("drawing")
                draw(first, second, options.plot)
    except InputError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename}: {error.strerror}")
    if not show(parser.prog, [*lines, *beyond]):
        return 2
    return 1 if beyond else 0


def _compare(
    bags: tuple[Bag, Bag], options: argparse.Namespace, progress: ProgressLine
) -> tuple[list[str], list[str]]:
    """Lines on the differences, and on the figures beyond the tolerances."""
    from slot_core.dynamics.servo import read_servo  # noqa: PLC0415 - heavy
    from slot_core.recording.record_settings import read_record_settings  # noqa: PLC0415
    from slot_lab.report.figures import figures  # noqa: PLC0415
    from slot_lab.report.metrics import walk_metrics  # noqa: PLC0415
    from slot_lab.report.origin_changes import origin_lines  # noqa: PLC0415

    warm_up = (
        read_record_settings().warm_up if options.warm_up is None else options.warm_up
    )
    walks = []
    for bag in bags:
        progress(f"figures of {bag.path}")
        walks.append(walk_metrics(bag, warm_up, read_servo()))
    pairs = compare_figures(*map(figures, walks))
    head = "".join(
        f"{name:>{VALUE_WIDTH}}" for name in ("first", "second", "difference")
    )
    named = list(zip(("first", "second"), bags))
    lines = [f"{which:<8}{bag.path}" for which, bag in named]
    lines += [f"{which:<8}{bag.remark}" for which, bag in named if bag.remark]
    sources = dict.fromkeys(walk.source for walk in walks)
    lines += ["", *origin_lines(*bags), "", f"motion from {' -> '.join(sources)}"]
    lines += [f"after {warm_up:g} s of warm-up", f"{'':<{NAME_WIDTH}}{head}"]
    return [*lines, *map(str, pairs)], exceeded(pairs, options.tolerance)


def _number(value: float) -> str:
    return f"{value:.6g}" if math.isfinite(value) else "-"


def _tolerance(text: str) -> Tolerance:
    pattern, separator, number = text.rpartition("=")
    try:
        largest = float(number)
    except ValueError:
        largest = math.nan
    if not (separator and pattern and 0.0 <= largest < math.inf):
        raise argparse.ArgumentTypeError(
            f"{quoted(text)}: expected FIGURE=N, N in [0, inf)"
        )
    return Tolerance(pattern, largest)


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("compare", f"{__doc__}\n{EXIT_CODES}")
    add = parser.add_argument
    add(
        "bags",
        nargs=2,
        type=Path,
        metavar="BAG",
        help="directory of a bag, or its file",
    )
    most = "largest difference of a figure, in its unit, as height_mean=0.5; patterns of a shell"
    more = f"{most} for several, as '*drift*=2'; may be repeated, the last that matches counts"
    add(
        "--tolerance",
        type=_tolerance,
        action="append",
        default=[],
        metavar="FIGURE=N",
        help=more,
    )
    add(
        "--plot",
        type=Path,
        metavar="FILE",
        help=f"draw both walks: {', '.join(SUFFIXES)}",
    )
    left_out = "left out at the start (default: warm_up of config/record.yaml)"
    add("--warm-up", type=within(0.0, 3600.0, "s"), metavar="S", help=left_out)
    add("--namespace", default="", metavar="NAME", help="of the recorded graphs")
    return parser


if __name__ == "__main__":
    sys.exit(main())
