"""The release test of the leg: error against cost, for CosseratRod and alternative simulators.

The leg (clamped, no gravity) is bent by 1 N at its tip, neither in its plane nor across it, and
released. The error is the root mean square of the tip's distance from the converged motion over
1 s, over the initial deflection; the cost is CPU time. Each simulator is compared with its own
converged motion, because their physics differ:

    damped      Kelvin-Voigt damping; MuJoCo's hinge chain has it too, without stretch
    undamped    PyElastica has no Kelvin-Voigt damping; it shears and its sections have inertia
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.harness import Check, at_least, at_most, cpu_time
from slot_core.arrays import Array
from slot_core.refusal import DivergenceError
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import (
    Geometry,
    Loads,
    Material,
    Rectangle,
    RodState,
    Scheme,
)

LEG = Geometry(0.19, Rectangle(0.02, (0.0135, 0.0035)))
TPU = Material(1e7, 1e7 / 3, 1200.0, 5e-4)
PUSH = Loads(force=(0.0, 0.6, -0.8))  # neither in the leg's plane nor across it
DURATION, SAMPLES = 1.0, 100  # s, number of samples of the tip
OURS = "CosseratRod"
LARGEST_ERROR = 0.5  # percent
# of the cost from 7 to 31 nodes; 5 if proportional to their segments
LARGEST_GROWTH = 6.0
NODES = (4, 5, 7, 9, 13, 17, 31)
# s; the longest one damped, the shortest undamped
STEPS = (2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4)
SCHEMES = ((0.5, 1), (0.5, 2), (0.5, 20), (0.55, 2))  # theta, iterations


@dataclass(frozen=True)
class Physics:
    """Physical effects that are modelled."""

    name: str
    damped: bool

    def leg(self, nodes: int, scheme: Scheme) -> tuple[CosseratRod, RodState]:
        """The leg, and its equilibrium under PUSH."""
        rod = CosseratRod(
            TPU if self.damped else UNDAMPED_TPU, LEG, nodes, scheme=scheme
        )
        rod.solve_static(PUSH)
        return rod, rod.state

    def exact(self) -> Array:
        """(SAMPLES, 3) tip of 41 nodes, extrapolated from steps of 40 and 20 us."""
        paths = []
        for h in (4e-5, 2e-5):
            rod, _ = self.leg(41, Scheme(tolerance=1e-10))
            paths.append(rod.run(h, round(DURATION / h), samples=SAMPLES))
        return paths[1] + (paths[1] - paths[0]) / 3


UNDAMPED_TPU = replace(TPU, damping_time=0.0)
DAMPED = Physics("damped", damped=True)
UNDAMPED = Physics("undamped", damped=False)


@dataclass(frozen=True)
class Setting:
    """A fixed setting of CosseratRod for the checks: midpoint rule.

    Not the best of all rows, because there errors of space and time may cancel by chance.
    """

    physics: Physics
    nodes: int
    h: float
    iterations: int = 1

    def row(self, rows: list[dict[str, Any]]) -> dict[str, Any]:
        """The row of this setting."""
        wanted = {
            "simulator": OURS,
            "physics": self.physics.name,
            "nodes": self.nodes,
            "h": self.h,
            "theta": 0.5,
            "iterations": self.iterations,
        }
        return next(row for row in rows if wanted.items() <= row.items())

    def __str__(self) -> str:
        step = f"{self.nodes} nodes, {1e3 * self.h:g} ms, iterations {self.iterations}"
        return f"{self.physics.name}, {step}"


# From some 25 nodes on the damped leg diverges, after a second, with one iteration at 1 ms.
GOALS = (
    Setting(DAMPED, 7, 1e-3),
    Setting(DAMPED, 7, 1e-3, 2),
    Setting(DAMPED, 31, 1e-3, 2),
)
# None whose errors of space and time cancel by chance, as with 9 nodes at 1 ms.
RIVALS = (  # peer, the setting compared with it, least ratio of the costs
    ("MuJoCo", Setting(DAMPED, 5, 1e-3), 20.0),
    ("MuJoCo", Setting(DAMPED, 7, 1e-3), 20.0),
    ("MuJoCo", Setting(DAMPED, 13, 5e-4), 20.0),
    ("PyElastica", Setting(UNDAMPED, 7, 1e-3), 100.0),
)


def own_rows(
    physics: Physics, quick: bool, repeats: int
) -> Iterator[dict[str, Any]]:
    """CosseratRod over number of nodes, time step and scheme; NaN where the scheme diverges."""
    exact, steps = physics.exact(), STEPS[:-1] if physics.damped else STEPS[1:]
    schemes = SCHEMES[:2] if quick or not physics.damped else SCHEMES
    for nodes, h, (theta, iterations) in itertools.product(
        NODES, steps, schemes
    ):
        rod, bent = physics.leg(nodes, Scheme(theta, iterations))
        error, cost = math.nan, math.nan

        def release(
            rod: CosseratRod = rod, bent: RodState = bent, h: float = h
        ) -> Array:
            rod.state = bent
            return rod.run(h, round(DURATION / h), samples=SAMPLES)

        try:
            error = percent(release(), exact, bent.position[-1])
            cost = cpu_time(release, repeats) / DURATION
        except DivergenceError:
            pass
        yield release_row(
            OURS,
            physics,
            nodes,
            h=h,
            theta=theta,
            iterations=iterations,
            percent=error,
            cpu_s=cost,
        )


def release_row(
    simulator: str, physics: Physics, nodes: int, **figures: Any
) -> dict[str, Any]:
    """A row of the release test."""
    return {
        "kind": "release",
        "simulator": simulator,
        "physics": physics.name,
        "nodes": nodes,
        **figures,
    }


def percent(tip: Array, exact: Array, start: Array) -> float:
    """RMS error of the tip's path (SAMPLES, 3), % of its deflection at the start (3,)."""
    deviation = math.sqrt(((tip - exact) ** 2).sum(axis=1).mean())
    return 100 * deviation / math.dist(start, (LEG.length, 0.0, 0.0))


def release_checks(rows: list[dict[str, Any]]) -> list[Check]:
    """Errors at the fixed settings, ratios of their costs, and of the peers' costs to theirs."""
    found = [setting.row(rows) for setting in GOALS]
    out = [
        at_most(
            f"release, {setting}: error", row["percent"], LARGEST_ERROR, "%"
        )
        for setting, row in zip(GOALS, found)
    ]
    out.append(
        at_most(
            "release: cost of 31 nodes over 7",
            found[2]["cpu_s"] / found[1]["cpu_s"],
            LARGEST_GROWTH,
        )
    )
    for peer, setting, goal in RIVALS:
        rivals = [row for row in rows if row["simulator"].startswith(peer)]
        out.append(rival_check(peer, setting.row(rows), rivals, goal))
    return out


def rival_check(
    peer: str, own: dict[str, Any], rivals: list[dict[str, Any]], goal: float
) -> Check:
    """Ratio of the costs of a peer and `own` at equal error, %.

    The peer's cost is interpolated, in logarithms, between its best rows:
    a row that just misses an error would else count for nothing. Where none is as exact as ours its
    most exact one counts.
    """
    front, best = list[tuple[float, float]](), math.inf
    for cost, error in sorted((row["cpu_s"], row["percent"]) for row in rivals):
        if error < best:
            front.append((math.log(error), math.log(cost)))
            best = error
    if not front:
        return at_least(f"times faster than {peer}", math.nan, goal)
    errors, costs = zip(*reversed(front))
    error = max(own["percent"], best)
    cost = math.exp(float(np.interp(math.log(error), errors, costs)))
    name = f"times faster than {peer} at {error:.2g} %, ours {own['percent']:.2g} %"
    return at_least(name, cost / own["cpu_s"], goal)
