"""Draws the pictures of the documentation again: all of them, or those that are named.

Those of a benchmark are drawn from what its last run has left, results/NAME/NAME.json and
courses.npz: scripts/bench NAME measures, this script does not. The others are simulated, recorded
or learned anew, by the commands that --list names; those of scripts/play need Chromium.
"""

from __future__ import annotations

import pkgutil
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.harness import COURSES
from benchmarks.report.results import ReportError, read_benchmark
from documentation import DOC, ROOT
from slot_core.command_line import command_parser, progress, refuse
from slot_core.refusal import InputError, quoted

CANNOT_DRAW = 2  # exit code
Draw = Callable[[Any, Path], object]
Rows = Sequence[Mapping[str, Any]]


class PictureError(InputError):
    """A picture that cannot be drawn; the message is one line."""


@dataclass(frozen=True)
class Picture:
    """A picture: where it comes from, and what draws it from the results in a directory."""

    source: str  # what --list says
    draw: Callable[[Path, Path], object]  # directory of the results, file
    needs: tuple[str, str] = (
        "",
        "",
    )  # benchmark, its file without which there is no picture


def of_rows(benchmark: str, draw: str, kind: str | None = "") -> Picture:
    """Drawn from the rows of a benchmark: all, those of a kind, or with None those without one."""

    def make(results: Path, path: Path) -> None:
        rows = read_rows(results, benchmark)
        named(draw)(
            [row for row in rows if kind == "" or row.get("kind") == kind], path
        )

    return Picture(
        f"results of scripts/bench {benchmark}", make, (benchmark, f"{benchmark}.json")
    )


def of_courses(benchmark: str, draw: str) -> Picture:
    """Drawn from the courses over time of a benchmark."""

    def make(results: Path, path: Path) -> None:
        import numpy as np  # noqa: PLC0415 - heavy

        with np.load(results / benchmark / COURSES) as courses:
            named(draw)(dict(courses), path)

    return Picture(f"results of scripts/bench {benchmark}", make, (benchmark, COURSES))


def drawn(draw: str, source: str) -> Picture:
    """Drawn without results, by a function of the file."""
    return Picture(source, lambda _, path: named(draw)(path))


def ran(
    commands: Sequence[str], file: str, take: Callable[[Path, Path], object]
) -> Picture:
    """Made of a file in an empty directory, {}, in which commands have been run."""

    def make(_: Path, path: Path) -> None:
        with tempfile.TemporaryDirectory() as place:
            for command in commands:
                words = [word.replace("{}", place) for word in shlex.split(command)]
                words[0] = (
                    str(ROOT / words[0])
                    if words[0].startswith("scripts/")
                    else words[0]
                )
                if subprocess.run(words, cwd=place, check=False).returncode:
                    raise PictureError(f"{command}: failed")
            take(Path(place, file), path)

    return Picture("; ".join(commands), make)


def shrink(path: Path) -> None:
    """Write a picture again with a palette, within some 20 of 255 of its colours: a third of it."""
    from PIL import Image  # noqa: PLC0415 - heavy

    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(
            256, Image.Quantize.MAXCOVERAGE, 1, None, Image.Dither.NONE
        )
    small.save(path, optimize=True)


def view_image(page: Path, path: Path) -> None:
    """Write what the page of a run shows at a moment."""
    named("documentation.page_pictures:write_view")(page, path)


PUSH = "scripts/run --lockstep --scene push --seed 1 --duration 8 --bag {}/push"
WALK = "scripts/run --lockstep --duration 8 --bag {}/flat"
SLOPE = "scripts/run --lockstep --duration 8 --scene slope5 --vx 0.04 --bag {}/slope5"
COMPARED = "scripts/compare {}/flat {}/slope5 --plot {}/compare.png"
TWIN = f"scripts/twin {ROOT}/slot_bringup/example/walk --out {{}}"
FIT = f"{TWIN} --fit friction,young_modulus,tendon_offset"
PLOTS = "benchmarks.locomotion.plots"
PICTURES = {
    "gaits.png": drawn("benchmarks.locomotion.stills:draw", "simulated"),
    "leg.png": drawn("documentation.leg_plot:write", "simulated"),
    "prediction.png": drawn("benchmarks.locomotion.predicted_stride:draw", "simulated"),
    "play.png": drawn(
        "documentation.play_panels:write_page", "scripts/play in Chromium"
    ),
    "play_panels.png": drawn(
        "documentation.play_panels:write_panels", "scripts/play in Chromium"
    ),
    "view.png": ran(
        [PUSH, "scripts/view {}/push --html {}/x.html"], "x.html", view_image
    ),
    "compare.png": ran([WALK, SLOPE, COMPARED], "compare.png", shutil.copyfile),
    "locomotion_table.png": of_rows("locomotion", f"{PLOTS}:draw_table", None),
    "locomotion_velocity.png": of_courses("locomotion", f"{PLOTS}:draw_velocity"),
    "locomotion_top.png": of_courses("locomotion", f"{PLOTS}:draw_top"),
    "margins.png": of_rows(
        "locomotion", "benchmarks.locomotion.margins:draw", "margin"
    ),
    "mpc_solvers.png": of_rows("mpc", "benchmarks.mpc.plots:draw"),
    "robot_cost.png": of_rows("robot", "benchmarks.robot.plots:draw"),
    "other_engine.png": of_rows(
        "robot", "benchmarks.robot.plots:draw_engines", "replay"
    ),
    "perturbations.png": of_courses(
        "perturbations", "benchmarks.perturbations.plots:draw_courses"
    ),
    "walk.png": ran(
        ["scripts/run --duration 20 --bag {}/walk"], "walk/walk.png", shutil.copyfile
    ),
    "walk.gif": ran(
        [PUSH, "scripts/view {}/push --animate {}/x.gif"], "x.gif", shutil.copyfile
    ),
    "walk.html": ran(
        [PUSH, "scripts/view {}/push --html {}/x.html"], "x.html", shutil.copyfile
    ),
    "vision.png": drawn("benchmarks.estimation.vision_rows:draw_film", "simulated"),
    "twin.png": ran([FIT], "twin.png", shutil.copyfile),
    "learning.png": ran(
        [f"python {ROOT}/scripts/examples/learn_to_walk.py"],
        "learning.png",
        shutil.copyfile,
    ),
}
"""Pictures by file of slot_bringup/doc."""


def named(function: str) -> Draw:
    """The function of a module, `module:function`, imported when it is needed."""
    found: Draw = pkgutil.resolve_name(function)
    return found


def read_rows(results: Path, benchmark: str) -> Rows:
    """Rows of a benchmark, with NaN in the place of null; raises PictureError, ReportError."""
    found = read_benchmark(results, benchmark, {})
    if found is None:
        raise PictureError(_missing(results, benchmark, f"{benchmark}.json"))
    blank = float("nan")
    return [
        {k: blank if v is None else v for k, v in row.items()} for row in found.rows
    ]


def missing(results: Path, picture: Picture) -> str:
    """Why a picture cannot be drawn from the results there are, or ""."""
    benchmark, file = picture.needs
    if not benchmark or (results / benchmark / file).is_file():
        return ""
    return _missing(results, benchmark, file)


def _missing(results: Path, benchmark: str, file: str) -> str:
    return f"{results / benchmark / file}: missing; scripts/bench {benchmark} writes it"


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/docs --pictures`; exit code 2 for what cannot be drawn."""
    parser = command_parser("docs --pictures", __doc__)
    add = parser.add_argument
    add("names", nargs="*", metavar="NAME", help="of pictures (default: all)")
    add(
        "--list",
        action="store_true",
        help="list the pictures, and where each comes from",
    )
    add(
        "--results",
        type=Path,
        default=ROOT / "results",
        metavar="DIR",
        help="default: results",
    )
    add(
        "--out", type=Path, default=DOC, metavar="DIR", help="default: slot_bringup/doc"
    )
    options = parser.parse_args(arguments)
    if options.list:
        for name, picture in PICTURES.items():
            print(f"{name:<26}{picture.source.replace(f'{ROOT}/', '')}")
        return 0
    try:
        draw(options.names or [*PICTURES], options.results, options.out)
    except (PictureError, ReportError) as error:
        refuse(parser.prog, error)
        return CANNOT_DRAW
    return 0


def draw(names: Sequence[str], results: Path, out: Path) -> None:
    """Draw pictures; raises PictureError and ReportError, before the work where that is known."""
    if unknown := [name for name in names if name not in PICTURES]:
        raise PictureError(f"no picture {quoted(unknown[0])} (see --list)")
    if not out.is_dir():
        raise PictureError(f"--out {out}: not a directory")
    for name in names:
        if why := missing(results, PICTURES[name]):
            raise PictureError(f"{name}: {why}")
    for name in names:
        PICTURES[name].draw(results, out / name)
        if name.endswith(".png"):
            shrink(out / name)
        progress(str(out / name))


if __name__ == "__main__":
    sys.exit(main())
