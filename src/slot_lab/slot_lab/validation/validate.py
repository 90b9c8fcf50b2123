"""Compares a run with a measurement: aligned in time and space, with the paper's error metrics.

RUN and MEASUREMENT are each a bag, a CSV file with the header time,point,x,y,z (m, s) or
time,x,y,z[,roll,pitch,yaw], a trajectory of TUM (time x y z qx qy qz qw, no header), or a video,
whose markers are tracked as by scripts/validate --track (see its --help). MEASUREMENT is the
reference: errors are RUN minus MEASUREMENT. The intervals are 95 % of a block bootstrap.
"""

import argparse
import math
import sys
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from slot_core.command_line import ProgressLine, command_parser, within
from slot_core.names import LEGS
from slot_lab.bags.replay_command import add_remap
from slot_lab.bags.topics import MOTION_TOPICS
from slot_lab.desk_command import Outcome, run_command
from slot_lab.verdict import EXIT_CODES

FRAMES = ("rigid", "level", "none")
OUT = Path("results", "validate")


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/validate`; ends with exit code 2 and one line on a bad input."""
    parser = command_parser("validate", f"{__doc__}\n{EXIT_CODES}")
    add = parser.add_argument
    add("run", type=Path, metavar="RECORDING", help="bag, CSV or video")
    add("measurement", type=Path, metavar="RECORDING", help="bag, CSV or video")
    add("--out", type=Path, metavar="DIR", default=OUT, help=f"default: {OUT}")
    add(
        "--frame",
        choices=FRAMES,
        default="level",
        help="what is free between the frames: rotation and shift, turn about z and shift,"
        " nothing (default: level)",
    )
    time = within(1e-3, 1e6, "s")
    add(
        "--frame-time",
        type=time,
        metavar="S",
        default=math.inf,
        help="align the frames by the first S seconds only, so that later errors show",
    )
    add(
        "--zero",
        action="store_true",
        help="take out each point's mean difference over that time: markers beside their"
        " points",
    )
    add(
        "--offset",
        type=within(-1e6, 1e6, "s"),
        metavar="S",
        help="time of the measurement's first sample in the run, to 0.1 s"
        " (default: searched)",
    )
    add(
        "--sigma",
        type=within(1e-6, 1.0, "m"),
        metavar="M",
        default=1e-3,
        help="standard uncertainty of the measured positions, for the verdict"
        " (default: 0.001 m)",
    )
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
    add(
        "--camera",
        type=Path,
        metavar="FILE",
        help="calibration of a video's camera",
    )
    add("--namespace", metavar="NAME", default="", help="of the run's bag")
    add_remap(parser)
    add_remap(parser, "--remap-measured", "measurement's ")
    add(
        "--motion",
        default="",
        choices=MOTION_TOPICS,
        help="motion of the run's bag (default: the first of these that is recorded)",
    )
    return run_command(parser, parser.parse_args(arguments), run)


def run(options: argparse.Namespace, progress: ProgressLine) -> Outcome:
    """Compare and write the files; returns the tables and the verdict's exit code."""
    from slot_lab.validation import tables  # noqa: PLC0415 - heavy
    from slot_lab.validation.comparison import compare, judge  # noqa: PLC0415
    from slot_lab.validation.recording import RecordingError, read_recording  # noqa: PLC0415

    progress(f"reading {options.run}", 0.0)
    run = read_recording(
        options.run,
        options.camera,
        options.motion,
        partial(progress, f"reading {options.run}"),
        namespace=options.namespace,
        remap=dict(options.remap),
    )
    progress(f"reading {options.measurement}", 0.0)
    measured = read_recording(
        options.measurement,
        options.camera,
        tell=partial(progress, f"reading {options.measurement}"),
        remap=dict(options.remap_measured),
    )
    for recording in (run, measured):
        if recording.tilted and options.frame != "rigid":
            raise RecordingError(
                f"{recording.name}: no board places the camera in odom, so the tracks are"
                " in its axes; align them with --frame rigid"
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
    verdict = judge(found, options.sigma, options.frame, options.zero)
    out = options.out
    out.mkdir(parents=True, exist_ok=True)
    (out / "summary.txt").write_text(
        "\n".join([*lines, "", verdict.line]) + "\n"
    )
    tables.write_csv(found, out / "errors.csv")
    progress("drawing")
    plots = tables.draw(found, f"{run.name} and {measured.name}", out)
    names = ["summary.txt", "errors.csv", *(path.name for path in plots)]
    return [
        *lines,
        "",
        f"{', '.join(names)} are in {out}",
        verdict.line,
    ], verdict.code


if __name__ == "__main__":
    sys.exit(main())
