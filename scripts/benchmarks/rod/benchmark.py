"""Accuracy and speed of the spatial Cosserat rod: statics, vibration, conservation and a release.

Static errors are the tip's over the length, against closed forms, published figures and
collocation (exact.py). In the release test (release.py) MuJoCo and PyElastica run as peers.
"""

from collections.abc import Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

from benchmarks.harness import Outcome, Progress, Row, at_most, mark_front
from benchmarks.plots import CostCurve, draw_error_over_cost
from benchmarks.rod import mujoco_chain, pyelastica_rod, release, statics
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
    """Run all tests; the plot of the release test goes to `out/rod.png`."""
    repeats = 3 if quick else 9
    progress("statics and vibration")
    still = [*statics.static_rows(repeats), *statics.frequency_rows()]
    progress("energy and momentum")
    moving = list(release.energy_rows())
    released = []
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
    flight = [
        row["momentum"]
        for row in moving
        if row["kind"] == "flight" and row["theta"] == 0.5
    ]
    return [*still, *moving, *released], [
        *statics.static_checks(still),
        at_most(
            "relative drift of momentum in flight, midpoint rule", max(flight), 1e-12
        ),
        *release.release_checks(released),
    ]


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
        runs = [(row["cpu_s"], row["percent"], str(row["nodes"])) for row in shown]
        best = [run for run, row in zip(runs, shown) if row["front"]]
        series.append(CostCurve(", ".join(curve), *look, runs, best))
    draw_error_over_cost(
        series,
        path,
        xlim=COST,
        ylim=ERROR,
        xlabel="CPU seconds per simulated second",
        ylabel="error of the tip, % of its first deflection",
        title="Release of the leg from an oblique force; numbers: nodes",
    )
