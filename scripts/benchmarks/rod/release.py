"""The release of the leg: error against cost, with the simulators that a user could pick instead.

The leg (clamped, no gravity) is bent by 1 N at its tip and let go. The error is the root mean
square of the tip's distance from a fine solution of the same physics over 1 s, over the initial
deflection; the cost is CPU time. Three kinds of physics, for each simulator has its own:

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

DURATION, SAMPLES = 1.0, 100  # s, and how often the tip is looked at
OURS = "CosseratRod"
LARGEST_COST, LARGEST_ERROR = 0.0025, 0.5  # CPU s per simulated s; percent


@dataclass(frozen=True)
class Physics:
    """What of the leg is modelled."""

    name: str
    shear: bool
    damped: bool

    def leg(self, elements: int, scheme: Scheme) -> tuple[CosseratRod, RodState]:
        """The leg and its state under the push."""
        material = TPU if self.damped else replace(TPU, damping_time=0.0)
        rod = CosseratRod(
            material, LEG, elements, shear=self.shear, rotary_inertia=self.shear, scheme=scheme
        )
        rod.solve_static(PUSH)
        return rod, rod.state

    def exact(self) -> Array:
        """(SAMPLES, 2) tip of 41 nodes, extrapolated from steps of 40 and 20 us."""
        ways = []
        for h in (4e-5, 2e-5):
            rod, _ = self.leg(20, Scheme(tolerance=1e-11))
            ways.append(rod.run(h, round(DURATION / h), samples=SAMPLES)[:, :2])
        return ways[1] + (ways[1] - ways[0]) / 3


DAMPED = Physics("damped", shear=False, damped=True)
DAMPED_SHEAR = Physics("damped, shear", shear=True, damped=True)
UNDAMPED_SHEAR = Physics("undamped, shear", shear=True, damped=False)


@dataclass(frozen=True)
class Setting:
    """A setting of ours that checks name beforehand: the midpoint rule with a single iteration.

    Not the best of all rows: where errors of space and time cancel, that would be luck.
    """

    physics: Physics
    nodes: int
    h: float

    def row(self, rows: list[dict[str, Any]]) -> dict[str, Any]:
        """Its row."""
        wanted = {
            "simulator": OURS, "physics": self.physics.name, "nodes": self.nodes, "h": self.h,
            "theta": 0.5, "iterations": 1,
        }  # fmt: skip
        return next(row for row in rows if wanted.items() <= row.items())

    def __str__(self) -> str:
        return f"{self.physics.name}, {self.nodes} nodes, {1e3 * self.h:g} ms"


# The fewest nodes within the goal at any smaller step, and the standard.
GOALS = tuple(Setting(p, n, 1e-3) for n in (7, 31) for p in (DAMPED, DAMPED_SHEAR))
RIVALS = {  # with which each peer is compared, and how many times faster it has to be
    "MuJoCo": (Setting(DAMPED, 7, 1e-3), 3.0),
    "PyElastica": (Setting(UNDAMPED_SHEAR, 17, 5e-4), 100.0),
}


def own_rows(physics: Physics, exact: Array, quick: bool, repeats: int) -> list[dict[str, Any]]:
    """Our rod over N, step and scheme."""
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
    """Error of the tip's way (SAMPLES, 2), % of its deflection at the start."""
    deviation = math.sqrt(((tip - exact) ** 2).sum(axis=1).mean())
    return 100 * deviation / math.dist(start[:2], (LEG.length, 0.0))


def energy_rows() -> Iterator[dict[str, Any]]:
    """Drift of energy and momentum over 1 s without damping, by integrator.

    In flight the leg is thrown, spins and vibrates. After the release it vibrates in its clamp.
    """
    for theta in (0.5, 0.55, 1.0):
        for h in (1e-3, 5e-4, 2.5e-4):
            scheme = Scheme(theta, tolerance=1e-13)
            released, bent = UNDAMPED_SHEAR.leg(8, scheme)
            released.state = bent
            for kind, rod in (("flight", thrown(scheme)), ("vibration", released)):
                yield {"kind": kind, "theta": theta, "h": h, **drift(rod, h, kind == "flight")}


def drift(rod: CosseratRod, h: float, free: bool) -> dict[str, float]:
    """Largest and last change of energy, and of momentum where the rod is free, over 1 s."""
    momentum, energy, change = np.array(rod.momentum()), rod.energy().total, [0.0]
    for _ in range(50):
        rod.run(h, round(DURATION / 50 / h))
        change.append(rod.energy().total / energy - 1)
    out = {"energy": max(map(abs, change)), "energy_end": change[-1]}
    if free:
        out["momentum"] = float(np.abs(np.array(rod.momentum()) / momentum - 1).max())
    return out


def thrown(scheme: Scheme) -> CosseratRod:
    """The leg without damping in flight: 8 rad/s, 0.4 m/s, and a velocity that bends it."""
    rod = CosseratRod(replace(TPU, damping_time=0.0), LEG, 8, base=FREE, scheme=scheme)
    pose = rod.state.pose
    velocity = 8.0 * np.column_stack([-pose[:, 1], pose[:, 0], np.ones(len(pose))])
    velocity[:, 0] += 0.3
    velocity[:, 1] += 60.0 * (pose[:, 0] - 0.1) ** 2 - 0.2
    rod.state = RodState(pose, velocity)
    return rod


def mark_front(rows: list[dict[str, Any]]) -> None:
    """Mark the rows of which no other of the same physics is both faster and more exact."""
    for row in rows:
        row["front"] = row["percent"] < math.inf and not any(
            other["physics"] == row["physics"]
            and other["cpu_s"] < row["cpu_s"]
            and other["percent"] < row["percent"]
            for other in rows
        )


def release_checks(rows: list[dict[str, Any]]) -> list[Check]:
    """Error and cost at settings named beforehand, and how far ahead of the peers they are."""
    out = []
    for setting in GOALS:
        row = setting.row(rows)
        out.append(at_most(f"release, {setting}: error", row["percent"], LARGEST_ERROR, "%"))
        out.append(at_most(f"release, {setting}: cost", row["cpu_s"], LARGEST_COST, "CPU s per s"))
    for peer, (setting, goal) in RIVALS.items():
        rivals = [row for row in rows if row["simulator"].startswith(peer)]
        out.append(rival_check(peer, setting.row(rows), rivals, goal))
    return out


def rival_check(peer: str, own: dict[str, Any], rivals: list[dict[str, Any]], goal: float) -> Check:
    """How many times faster `own` is than the fastest of a peer's rows that is exact enough.

    Enough is LARGEST_ERROR, or the error of `own` where that is larger. A peer that does not come
    that far is represented by its most exact row: then `own` is more exact, too.
    """
    enough = max(own["percent"], LARGEST_ERROR)
    reached = min((row["percent"] for row in rivals if row["percent"] < math.inf), default=math.nan)
    costs = [row["cpu_s"] for row in rivals if row["percent"] <= max(enough, reached)]
    name = f"times faster than {peer} within {max(enough, reached):.2g} %"
    return at_least(name, min(costs, default=math.nan) / own["cpu_s"], goal)
