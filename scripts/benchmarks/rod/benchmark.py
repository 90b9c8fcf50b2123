"""Accuracy and speed of the spatial Cosserat rod: statics, vibration, conservation and a release.

Static errors are those of the tip over the length, against closed forms, published figures and
collocation (exact.py). In the release test (release.py) MuJoCo and PyElastica run as peers.
"""

from pathlib import Path
from typing import Any

from benchmarks.harness import Outcome, Progress, at_most
from benchmarks.rod import plots, release, statics

REQUIRES = ("mujoco", "elastica")
ELEMENTS = {
    True: (10, 20, 30),
    False: (10, 20, 30, 60, 100),
}  # of PyElastica, by `quick`


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Run all tests; the plot of the release test goes to `out/rod.png`."""
    repeats = 3 if quick else 9
    progress("statics and vibration")
    still = [*statics.static_rows(repeats), *statics.frequency_rows()]
    progress("energy and momentum")
    moving = list(release.energy_rows())
    released = release_rows(quick, repeats, progress)
    release.mark_fronts(released)
    plots.draw(released, out / "rod.png")
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


def release_rows(quick: bool, repeats: int, progress: Progress) -> list[dict[str, Any]]:
    """The release test of CosseratRod and of the peers."""
    # Imported after REQUIRES is checked.
    from benchmarks.rod import mujoco_chain, pyelastica_rod  # noqa: PLC0415

    rows = []
    for physics in (release.DAMPED, release.UNDAMPED):
        progress(f"release test, {physics.name}")
        rows += release.own_rows(physics, quick, repeats)
    progress("release test, MuJoCo")
    rows += mujoco_chain.rows(quick, repeats)
    progress("release test, PyElastica")
    rows += pyelastica_rod.rows(quick, ELEMENTS[quick])
    return rows
