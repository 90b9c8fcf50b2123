"""Speed of the spatial Cosserat rod at equal error: a release, with MuJoCo and PyElastica as peers.

Statics, vibration and conservation are tested in test/rod.
"""

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from benchmarks.harness import Outcome, Progress, Row, mark_front
from benchmarks.plots import CostCurve, draw_error_over_cost
from benchmarks.rod import mujoco_chain, pyelastica_rod, release
from benchmarks.rod.release import DAMPED, OURS, UNDAMPED
from slot_core.drawing import palette

REQUIRES = ("mujoco", "elastica")
ELEMENTS = {True: (10, 20, 30), False: (10, 20, 30, 60, 100)}  # by `quick`
COST, ERROR = (5e-4, 5.0), (8e-3, 100.0)  # limits of the plot
CURVES = {  # simulator and physics: mark, colour
    (OURS, DAMPED.name): ("o", palette.STAGE_COLOURS[0]),
    ("MuJoCo hinge chain", DAMPED.name): ("X", palette.STAGE_COLOURS[1]),
    (OURS, UNDAMPED.name): ("D", palette.STAGE_COLOURS[2]),
    ("PyElastica, clamp as documented", UNDAMPED.name): ("P", palette.INK),
    ("PyElastica, clamp moved", UNDAMPED.name): ("*", palette.TRUE),
}


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Run the release test; its plot goes to `out/rod.png`."""
    repeats, released = 3 if quick else 9, list[Row]()
    for physics in (DAMPED, UNDAMPED):
        progress(f"release test, {physics.name}")
        released += release.own_rows(physics, quick, repeats)
    progress("release test, MuJoCo")
    released += mujoco_chain.rows(quick, repeats)
    progress("release test, PyElastica")
    released += pyelastica_rod.rows(quick, ELEMENTS[quick])
    for curve in CURVES:
        mark_front(released_by(released, curve), "cpu_s", itemgetter("percent"))
    draw(released, out / "rod.png")
    return released, release.release_checks(released)


def released_by(rows: Sequence[Any], curve: tuple[str, str]) -> list[Any]:
    """The rows of a simulator and its physics."""
    return [row for row in rows if (row["simulator"], row["physics"]) == curve]


def draw(rows: Sequence[Row], path: Path) -> None:
    """Write the plot of the release test; numbers: nodes."""
    series = []
    for curve, look in CURVES.items():
        shown = [
            row
            for row in released_by(rows, curve)
            if ERROR[0] < row["percent"] < ERROR[1]
        ]
        runs = [
            (row["cpu_s"], row["percent"], str(row["nodes"])) for row in shown
        ]
        series.append(
            CostCurve(
                ", ".join(curve),
                *look,
                runs,
                [run for run, row in zip(runs, shown) if row["front"]],
            )
        )
    draw_error_over_cost(
        series,
        path,
        xlim=COST,
        ylim=ERROR,
        xlabel="CPU seconds per simulated second",
        ylabel="error of the tip, % of its first deflection",
        title="Release of the leg from an oblique force; numbers: nodes",
    )
