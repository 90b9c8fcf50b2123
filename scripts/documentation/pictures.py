"""Draws the pictures of the documentation again: all of them, or those that are named.

Those of a benchmark are drawn from what its last run has left, results/NAME/NAME.json and
courses.npz: scripts/bench NAME measures, this script does not. The others are simulated, recorded
or learned anew, by the commands that --list names; those of scripts/play need Chromium.
"""

import pkgutil
import shlex
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.harness import COURSES
from documentation import DOC, ROOT
from documentation.results import ReportError, read_result
from slot_core.command_line import command_parser, progress
from slot_core.refusal import quoted
from slot_lab.desk_command import Outcome, run_command

Rows = Sequence[Mapping[str, Any]]


@dataclass(frozen=True)
class Picture:
    """A picture: what draws it, from the rows or courses of a benchmark or from commands.

    draw: `module:function` of the rows or courses, if there is a benchmark, and of the file.
    """

    draw: str = ""
    benchmark: str = ""
    courses: bool = False  # it is drawn from the courses over time
    # of the rows: all, those of a kind, or with None those without
    kind: str | None = ""
    commands: Sequence[str] = ()  # {} stands for an empty directory
    file: str = ""  # that the commands make, from which it is drawn, or which is the picture

    @property
    def source(self) -> str:
        """Where the picture comes from."""
        if self.benchmark:
            return f"results of scripts/bench {self.benchmark}"
        if "browser" in self.draw and not self.commands:
            return "scripts/play in Chromium"
        return "; ".join(self.commands).replace(f"{ROOT}/", "") or "simulated"

    def needs(self, results: Path) -> Path | None:
        """The result without which there is no picture."""
        file = COURSES if self.courses else f"{self.benchmark}.json"
        return results / self.benchmark / file if self.benchmark else None

    def make(self, results: Path, path: Path) -> None:
        """Draw it into a file; raises ReportError."""
        draw: Any = (
            pkgutil.resolve_name(self.draw) if self.draw else shutil.copyfile
        )
        if self.courses:
            import numpy as np  # noqa: PLC0415 - heavy

            with np.load(results / self.benchmark / COURSES) as courses:
                draw(dict(courses), path)
        elif self.benchmark:
            draw(
                [
                    r
                    for r in read_rows(results, self.benchmark)
                    if self.kind in ("", r.get("kind"))
                ],
                path,
            )
        elif self.commands:
            with tempfile.TemporaryDirectory() as place:
                for command in self.commands:
                    words = shlex.split(command.replace("{}", place))
                    words[0] = words[0].replace("scripts/", f"{ROOT}/scripts/")
                    if subprocess.run(words, cwd=place, check=False).returncode:
                        raise ReportError(f"{command}: failed")
                draw(Path(place, self.file), path)
        else:
            draw(path)


def shrink(path: Path) -> None:
    """Write a picture again with a palette, within some 20 of 255 of its colours: a third of it."""
    from PIL import Image  # noqa: PLC0415 - heavy

    with Image.open(path) as picture:
        small = picture.convert("RGB").quantize(
            256, Image.Quantize.MAXCOVERAGE, 1, None, Image.Dither.NONE
        )
    small.save(path, optimize=True)


PUSH = "scripts/run --lockstep --scene push --seed 1 --duration 8 --bag {}/push"
PAGE = [PUSH, "scripts/view {}/push --html {}/x.html"]
WALK = "scripts/run --lockstep --duration 8 --bag {}/flat"
SLOPE = "scripts/run --lockstep --duration 8 --scene slope5 --vx 0.04 --bag {}/slope5"
COMPARED = "scripts/compare {}/flat {}/slope5 --plot {}/compare.png"
FIT = "--fit friction,young_modulus,tendon_offset"
TWIN = f"scripts/twin {ROOT}/slot_bringup/example/walk --out {{}} {FIT}"
LEARN = f"python {ROOT}/scripts/examples/learn_to_walk.py"
ROBOT, BROWSER = (
    "documentation.robot_pictures",
    "documentation.browser_pictures",
)
PLOTS = "benchmarks.locomotion.plots"
PICTURES = {
    "gaits.png": Picture(f"{ROBOT}:draw_gaits"),
    "leg.png": Picture("documentation.leg_plot:write"),
    "prediction.png": Picture(f"{ROBOT}:draw_prediction"),
    "play.png": Picture(f"{BROWSER}:write_page"),
    "play_panels.png": Picture(f"{BROWSER}:write_panels"),
    "view.png": Picture(f"{BROWSER}:write_view", commands=PAGE, file="x.html"),
    "compare.png": Picture(
        commands=[WALK, SLOPE, COMPARED], file="compare.png"
    ),
    "locomotion_table.png": Picture(
        f"{PLOTS}:draw_table", "locomotion", kind=None
    ),
    "locomotion_velocity.png": Picture(
        f"{PLOTS}:draw_velocity", "locomotion", True
    ),
    "locomotion_top.png": Picture(f"{PLOTS}:draw_top", "locomotion", True),
    "margins.png": Picture(
        "benchmarks.locomotion.margins:draw", "locomotion", kind="margin"
    ),
    "mpc_solvers.png": Picture("benchmarks.mpc.benchmark:draw", "mpc"),
    "legs.png": Picture("benchmarks.legs.benchmark:draw", "legs", kind="leg"),
    "robot_cost.png": Picture("benchmarks.robot.benchmark:draw", "robot"),
    "other_engine.png": Picture(
        "benchmarks.robot.other_engine:draw_engines", "robot", kind="replay"
    ),
    "perturbations.png": Picture(
        "benchmarks.perturbations.benchmark:draw_courses", "perturbations", True
    ),
    "world.png": Picture("benchmarks.world.plots:draw", "world"),
    "walk.png": Picture(
        commands=["scripts/run --duration 20 --bag {}/walk"],
        file="walk/walk.png",
    ),
    "walk.gif": Picture(
        commands=[PUSH, "scripts/view {}/push --animate {}/x.gif"], file="x.gif"
    ),
    "walk.html": Picture(commands=PAGE, file="x.html"),
    "vision.png": Picture("benchmarks.estimation.vision_rows:draw_film"),
    "twin.png": Picture(commands=[TWIN], file="twin.png"),
    "learning.png": Picture(commands=[LEARN], file="learning.png"),
}
"""Pictures by file of slot_bringup/doc."""


def read_rows(results: Path, benchmark: str) -> Rows:
    """Rows of a benchmark, with NaN in the place of null; raises ReportError."""
    found = read_result(results, benchmark)
    assert found is not None  # `draw` has looked
    return [
        {k: float("nan") if v is None else v for k, v in row.items()}
        for row in found.rows
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line of `scripts/docs --pictures`; exit code 2 for what cannot be drawn."""
    parser = command_parser("docs --pictures", __doc__)
    add = parser.add_argument
    add("names", nargs="*", metavar="NAME", help="of pictures (default: all)")
    add(
        "--list",
        action="store_true",
        help="list the pictures and their sources",
    )
    add(
        "--results",
        type=Path,
        default=ROOT / "results",
        metavar="DIR",
        help="default: results",
    )
    add(
        "--out",
        type=Path,
        default=DOC,
        metavar="DIR",
        help="default: slot_bringup/doc",
    )
    options = parser.parse_args(arguments)
    if options.list:
        for name, picture in PICTURES.items():
            print(f"{name:<26}{picture.source}")
        return 0
    return run_command(parser, options, draw)


def draw(options: Any, *_: object) -> Outcome:
    """Draw pictures; raises ReportError, before the work where that is known."""
    names, out = options.names or [*PICTURES], options.out
    if unknown := [name for name in names if name not in PICTURES]:
        raise ReportError(f"no picture {quoted(unknown[0])} (see --list)")
    if not out.is_dir():
        raise ReportError(f"--out {out}: not a directory")
    for name in names:
        needed = PICTURES[name].needs(options.results)
        if needed and not needed.is_file():
            raise ReportError(
                f"{name}: {needed}: missing; scripts/bench"
                f" {PICTURES[name].benchmark} writes it"
            )
    for name in names:
        PICTURES[name].make(options.results, out / name)
        if name.endswith(".png"):
            shrink(out / name)
        progress(str(out / name))
    return (), 0


if __name__ == "__main__":
    sys.exit(main())
