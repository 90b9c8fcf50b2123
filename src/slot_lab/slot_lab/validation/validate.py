"""Compares a run with a measurement: aligned in time and space, with the paper's error metrics.

RUN and MEASUREMENT are each a bag, a CSV file with the header time,point,x,y,z (m, s) or
time,x,y,z[,roll,pitch,yaw], or a video, whose markers are tracked as by scripts/validate --track
(see its --help). MEASUREMENT is the reference: errors are RUN minus MEASUREMENT. The intervals are
95 % of a block bootstrap.
"""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from slot_core.command_line import command_parser, show, within
from slot_core.names import LEGS
from slot_core.progress import ProgressLine
from slot_core.refusal import InputError
from slot_lab.bags.topics import MOTION_TOPICS
from slot_lab.verdict import EXIT_CODES, Verdict

if TYPE_CHECKING:
    from slot_lab.validation.comparison import Comparison

CLOCK = 2  # free: offset and drift
FREE = {"rigid": 6, "level": 4, "none": 0}  # by frame


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/validate`; ends with exit code 2 and one line on a bad input."""
    parser = _parser()
    options = parser.parse_args(arguments)
    try:
        with ProgressLine(parser.prog) as progress:
            lines, verdict = _run(options, progress)
    except (InputError, OSError) as error:
        parser.error(str(error))
    return verdict.code if show(parser.prog, [*lines, verdict.line]) else 2


def _run(
    options: argparse.Namespace, progress: ProgressLine
) -> tuple[list[str], Verdict]:
    from slot_lab.validation import curves, tables  # noqa: PLC0415 - heavy
    from slot_lab.validation.comparison import compare  # noqa: PLC0415
    from slot_lab.validation.frame_alignment import RIGID  # noqa: PLC0415
    from slot_lab.validation.recording import RecordingError, read_recording  # noqa: PLC0415

    tell = partial(progress, f"reading {options.run}")
    tell(0.0)
    run = read_recording(
        options.run, options.namespace, options.camera, options.motion, tell
    )
    tell = partial(progress, f"reading {options.measurement}")
    tell(0.0)
    measured = read_recording(options.measurement, camera=options.camera, tell=tell)
    for recording in (run, measured):
        if recording.tilted and options.frame != RIGID:
            raise RecordingError(
                f"{recording.name}: no board places the camera in odom, so the tracks are in its"
                f" axes; align them with --frame {RIGID}"
            )
    progress("aligning")
    found = compare(
        run,
        measured,
        frame=options.frame,
        frame_time=options.frame_time,
        zero=options.zero,
        offset=options.offset,
        leg=options.leg,
        block=options.block,
        tell=partial(progress, "errors of the points"),
    )
    lines = [f"run {run.name}, measurement {measured.name}"]
    lines += [f"{r.name}: {note}" for r in (run, measured) for note in r.notes]
    lines += tables.report(found, options.frame)
    verdict = judge(found, options.sigma, FREE[options.frame], options.zero)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "summary.txt").write_text(
        "\n".join([*lines, "", verdict.line]) + "\n"
    )
    tables.write_csv(found, options.out / "errors.csv")
    progress("drawing")
    plots = curves.draw(found, f"{run.name} and {measured.name}", options.out)
    names = ["summary.txt", "errors.csv", *(path.name for path in plots)]
    return [*lines, "", f"{', '.join(names)} are in {options.out}"], verdict


def judge(found: Comparison, sigma: float, free: int, zero: bool) -> Verdict:
    """Verdict by the positions, whose standard uncertainty is `sigma` (m); free: in the frame.

    zero: whether each point's mean difference is taken out.
    """
    import numpy as np  # noqa: PLC0415 - heavy

    from slot_lab.validation.comparison import AXES  # noqa: PLC0415

    off = {
        key: (series.run - series.measured) / sigma
        for key, series in found.series.items()
        if key[1] in AXES
    }
    rms = {key: math.sqrt(float(np.mean(r**2))) for key, r in off.items()}
    point, axis = max(rms, key=lambda key: rms[key])
    taken = CLOCK + free + (3 * len(found.points) if zero else 0)
    return Verdict(
        sum(float(r @ r) for r in off.values()),
        sum(len(r) for r in off.values()) - taken,
        largest=f"largest: {point} {axis}, {rms[point, axis]:.3g} times the uncertainty",
    )


def _parser() -> argparse.ArgumentParser:
    parser = command_parser("validate", f"{__doc__}\n{EXIT_CODES}")
    add = parser.add_argument
    add("run", type=Path, metavar="RECORDING", help="bag, CSV or video")
    add("measurement", type=Path, metavar="RECORDING", help="bag, CSV or video")
    out = Path("results", "validate")
    add("--out", type=Path, metavar="DIR", default=out, help=f"default: {out}")
    free = "what is free between the frames: rotation and shift, turn about z and shift, nothing"
    add(
        "--frame", choices=tuple(FREE), default="level", help=f"{free} (default: level)"
    )
    begin = "align the frames by the first S seconds only, so that later errors show"
    time = within(1e-3, 1e6, "s")
    add("--frame-time", type=time, metavar="S", default=math.inf, help=begin)
    beside = "take out each point's mean difference over that time: markers beside their points"
    add("--zero", action="store_true", help=beside)
    offset = "time of the measurement's first sample in the run, to 0.1 s (default: searched)"
    add("--offset", type=within(-1e6, 1e6, "s"), metavar="S", help=offset)
    certain = "standard uncertainty of the measured positions, for the verdict (default: 0.001 m)"
    add("--sigma", type=within(1e-6, 1.0, "m"), metavar="M", default=1e-3, help=certain)
    add(
        "--leg",
        choices=LEGS,
        default="FL",
        help="leg of points without one (default: FL)",
    )
    add(
        "--block",
        type=time,
        metavar="S",
        default=1.0,
        help="of the bootstrap (default: 1 s)",
    )
    add("--camera", type=Path, metavar="FILE", help="calibration of a video's camera")
    add("--namespace", metavar="NAME", default="", help="of the run's bag")
    first = "motion of the run's bag (default: the first of these that is recorded)"
    add("--motion", default="", choices=MOTION_TOPICS, help=first)
    return parser


if __name__ == "__main__":
    sys.exit(main())
