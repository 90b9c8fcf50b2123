"""The release test of the leg: error against cost, for CosseratRod and alternative simulators.

The leg (clamped, no gravity) is bent by 1 N at its tip and released. The error is the root mean
square of the tip's distance from a fine solution of the same physics over 1 s, over the initial
deflection; the cost is CPU time. Three kinds of physics, because the simulators differ:

    damped           stretch, bending, Kelvin-Voigt damping; MuJoCo's hinge chain has this one
    damped, shear    the same with shear
    undamped, shear  without damping; PyElastica's rod has no Kelvin-Voigt damping
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.harness import Check, at_least, at_most, cpu_time
from benchmarks.rod.exact import LEG, PUSH, TPU
from slot_core.robot import Array
from slot_core.rod.cosserat_rod import CosseratRod, DivergenceError, RodState, Scheme
from slot_core.rod.model import FREE

DURATION, SAMPLES = 1.0, 100  # s, number of samples of the tip
OURS = "CosseratRod"
LARGEST_ERROR = 0.5  # percent
LARGEST_GROWTH = 6.0  # of the cost from 7 to 31 nodes; 4.4 if proportional to their number


@dataclass(frozen=True)
class Physics:
    """Physical effects that are modelled."""

    name: str
    shear: bool
    damped: bool

    def leg(self, elements: int, scheme: Scheme) -> tuple[CosseratRod, RodState]:
        """The leg, and its equilibrium under PUSH."""
        material = TPU if self.damped else replace(TPU, damping_time=0.0)
        rod = CosseratRod(
            material, LEG, elements, shear=self.shear, rotary_inertia=self.shear, scheme=scheme
        )
        rod.solve_static(PUSH)
        return rod, rod.state

    def exact(self) -> Array:
        """(SAMPLES, 2) tip of 41 nodes, extrapolated from steps of 40 and 20 us."""
        paths = []
        for h in (4e-5, 2e-5):
            rod, _ = self.leg(20, Scheme(tolerance=1e-11))
            paths.append(rod.run(h, round(DURATION / h), samples=SAMPLES)[:, :2])
        return paths[1] + (paths[1] - paths[0]) / 3


DAMPED = Physics("damped", shear=False, damped=True)
DAMPED_SHEAR = Physics("damped, shear", shear=True, damped=True)
UNDAMPED_SHEAR = Physics("undamped, shear", shear=True, damped=False)


@dataclass(frozen=True)
class Setting:
    """A fixed setting of CosseratRod for the checks: midpoint rule, one iteration.

    Not the best of all rows, because there errors of space and time may cancel by chance.
    """

    physics: Physics
    nodes: int
    h: float

    def row(self, rows: list[dict[str, Any]]) -> dict[str, Any]:
        """The row of this setting."""
        wanted = {
            "simulator": OURS, "physics": self.physics.name, "nodes": self.nodes, "h": self.h,
            "theta": 0.5, "iterations": 1,
        }  # fmt: skip
        return next(row for row in rows if wanted.items() <= row.items())

    def __str__(self) -> str:
        return f"{self.physics.name}, {self.nodes} nodes, {1e3 * self.h:g} ms"


# The fewest nodes within the goal at this and any smaller step, and the standard number.
GOALS = tuple((Setting(p, 7, 1e-3), Setting(p, 31, 1e-3)) for p in (DAMPED, DAMPED_SHEAR))
RIVALS = {  # by peer: the setting compared with it, and the least ratio of the costs
    "MuJoCo": (Setting(DAMPED, 7, 1e-3), 3.0),
    "PyElastica": (Setting(UNDAMPED_SHEAR, 17, 5e-4), 100.0),
}


def own_rows(physics: Physics, exact: Array, quick: bool, repeats: int) -> list[dict[str, Any]]:
    """CosseratRod over number of nodes, time step and scheme."""
    schemes = [(0.5, 1), (0.5, 2), (0.5, 20), (0.55, 2)]
    steps = [2e-3, 1e-3, 5e-4, 2.5e-4]
    if not physics.damped:
        schemes, steps = schemes[:2], [*steps[1:], 1.25e-4]
    elif quick:
        steps.pop()
    return [
        own_row(physics, exact, elements, h, Scheme(theta, iterations), repeats)
        for elements in (3, 4, 6, 8, 15)
        for h in steps
        for theta, iterations in schemes
    ]


def own_row(  # noqa: PLR0917
    physics: Physics, exact: Array, elements: int, h: float, scheme: Scheme, repeats: int
) -> dict[str, Any]:
    """One release; error and cost are NaN where the scheme diverges."""
    rod, bent = physics.leg(elements, scheme)
    error, cost = math.nan, math.nan

    def release() -> Array:
        rod.state = bent
        return rod.run(h, round(DURATION / h), samples=SAMPLES)[:, :2]

    try:
        error = percent(release(), exact, bent.pose[-1])
        cost = cpu_time(release, repeats).median / DURATION
    except DivergenceError:
        pass
    return {
        "kind": "release",
        "simulator": OURS,
        "physics": physics.name,
        "nodes": rod.nodes,
        "h": h,
        "theta": scheme.theta,
        "iterations": scheme.iterations,
        "percent": error,
        "cpu_s": cost,
    }


def percent(tip: Array, exact: Array, start: Array) -> float:
    """RMS error of the tip's path (SAMPLES, 2), % of its deflection at the start (2,)."""
    deviation = math.sqrt(((tip - exact) ** 2).sum(axis=1).mean())
    return 100 * deviation / math.dist(start[:2], (LEG.length, 0.0))


def energy_rows() -> Iterator[dict[str, Any]]:
    """Drift of energy and momentum over 1 s without damping, by integrator.

    `flight`: the free leg translates, spins and vibrates. `vibration`: the clamped leg is released.
    """
    for theta in (0.5, 0.55, 1.0):
        for h in (1e-3, 5e-4, 2.5e-4):
            scheme = Scheme(theta, tolerance=1e-13)
            released, bent = UNDAMPED_SHEAR.leg(8, scheme)
            released.state = bent
            for kind, rod in (("flight", thrown(scheme)), ("vibration", released)):
                yield {"kind": kind, "theta": theta, "h": h, **drift(rod, h, kind == "flight")}


def drift(rod: CosseratRod, h: float, free: bool) -> dict[str, float]:
    """Largest and final relative change of energy over 1 s; of momentum if the rod is free."""
    momentum, energy, change = np.array(rod.momentum()), rod.energy().total, [0.0]
    for _ in range(50):
        rod.run(h, round(DURATION / 50 / h))
        change.append(rod.energy().total / energy - 1)
    out = {"energy": max(map(abs, change)), "energy_end": change[-1]}
    if free:
        out["momentum"] = float(np.abs(np.array(rod.momentum()) / momentum - 1).max())
    return out


def thrown(scheme: Scheme) -> CosseratRod:
    """The undamped leg in free flight: 8 rad/s, 0.4 m/s, and a velocity that bends it."""
    rod = CosseratRod(replace(TPU, damping_time=0.0), LEG, 8, base=FREE, scheme=scheme)
    pose = rod.state.pose
    velocity = 8.0 * np.column_stack([-pose[:, 1], pose[:, 0], np.ones(len(pose))])
    velocity[:, 0] += 0.3
    velocity[:, 1] += 60.0 * (pose[:, 0] - 0.1) ** 2 - 0.2
    rod.state = RodState(pose, velocity)
    return rod


def mark_front(rows: list[dict[str, Any]]) -> None:
    """Mark the Pareto front: no other row of the same physics is both faster and more accurate."""
    for row in rows:
        row["front"] = row["percent"] < math.inf and not any(
            other["physics"] == row["physics"]
            and other["cpu_s"] < row["cpu_s"]
            and other["percent"] < row["percent"]
            for other in rows
        )


def release_checks(rows: list[dict[str, Any]]) -> list[Check]:
    """Errors at the fixed settings, ratios of their costs, and of the peers' costs to theirs."""
    out = []
    for settings in GOALS:
        few, many = (setting.row(rows) for setting in settings)
        for setting, row in zip(settings, (few, many)):
            out.append(at_most(f"release, {setting}: error", row["percent"], LARGEST_ERROR, "%"))
        name = f"release, {settings[0].physics.name}: cost of 31 nodes over that of 7"
        out.append(at_most(name, many["cpu_s"] / few["cpu_s"], LARGEST_GROWTH))
    for peer, (setting, goal) in RIVALS.items():
        rivals = [row for row in rows if row["simulator"].startswith(peer)]
        out.append(rival_check(peer, setting.row(rows), rivals, goal))
    return out


def rival_check(peer: str, own: dict[str, Any], rivals: list[dict[str, Any]], goal: float) -> Check:
    """Ratio of the cost of a peer's fastest row that is accurate enough to the cost of `own`.

    Accurate enough means within LARGEST_ERROR, or within the error of `own` if that is larger. A
    peer without such a row is represented by its most accurate one; `own` is then more accurate.
    """
    enough = max(own["percent"], LARGEST_ERROR)
    reached = min((row["percent"] for row in rivals if row["percent"] < math.inf), default=math.nan)
    costs = [row["cpu_s"] for row in rivals if row["percent"] <= max(enough, reached)]
    name = f"times faster than {peer} within {max(enough, reached):.2g} %"
    return at_least(name, min(costs, default=math.nan) / own["cpu_s"], goal)
