"""Static and vibration errors of the rod over its number of nodes."""

import math
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from benchmarks.harness import Check, at_least, at_most, cpu_time
from benchmarks.rod import exact
from benchmarks.rod.exact import LEG, PUSH, THIN, THIN_MATERIAL, TPU
from slot_core.robot import Array
from slot_core.rod.cosserat_rod import CosseratRod, RodState
from slot_core.rod.model import Geometry, Loads, Rectangle

ELEMENTS = (4, 8, 15, 32, 64)  # 9 .. 129 nodes
STANDARD = 15  # elements, 31 nodes, at which the goals are set
PERCENT = (0.1, 0.3, 0.6)  # goals of the first three frequencies' errors
COLUMN_OVERLOAD = 1.2  # of the load at which a column buckles


def slender(elements: int, taper: float = 1.0) -> CosseratRod:
    """A rod with L = EI = rho A = 1 at its base, without shear and rotary inertia."""
    geometry = Geometry(1.0, Rectangle(1.0, (THIN, THIN * taper)))
    return CosseratRod(THIN_MATERIAL, geometry, elements, shear=False, rotary_inertia=False)


def static_rows(repeats: int) -> Iterator[dict[str, Any]]:
    """Tips under loads, and buckling.

    `error` is against the exact case. `discretisation` is against collocation of the modelled rod,
    which stretches by 1e-6 of its length at load 10.
    """
    for p in (0.2, 1.0, 3.0, 10.0):
        yield from tip_rows("elastica", p, Loads(force=(0.0, p)), exact.elastica(p),
                            exact.thin(exact.dead(p)), repeats)  # fmt: skip
    for p in (1.0, 3.0, 10.0):
        yield from tip_rows("follower force", p, Loads(follower=(0.0, p)), exact.follower(p),
                            exact.thin(exact.across_tip(p)), repeats)  # fmt: skip
    for w in (1.0, 10.0, 50.0):
        yield from tip_rows("heavy elastica", w, Loads(gravity=(0.0, -w)), exact.heavy(w),
                            exact.thin(exact.weight(w)), repeats)  # fmt: skip
    yield from circle_rows()
    yield from leg_rows()
    yield buckling_row("Euler's column", exact.EULER, force=True)
    yield buckling_row("heavy column", exact.GREENHILL, force=False)


def tip_rows(  # noqa: PLR0917
    case: str, load: float, loads: Loads, tip: Array, modelled: Array, repeats: int
) -> Iterator[dict[str, Any]]:
    """Tip errors of a cantilever over the number of nodes; `tip` exact, `modelled` collocated."""
    for elements in ELEMENTS:
        rod = slender(elements)
        rest = rod.state
        found = rod.solve_static(loads)
        reached = rod.state.pose[-1, :2]

        def solve(rod: CosseratRod = rod, rest: RodState = rest) -> None:
            rod.state = rest
            rod.solve_static(loads)

        yield {
            "kind": case,
            "load": load,
            "nodes": rod.nodes,
            "error": math.dist(reached, tip),
            "discretisation": math.dist(reached, modelled),
            "iterations": found.iterations,
            "cpu_ms": 1e3 * cpu_time(solve, repeats).median,
        }


def circle_rows() -> Iterator[dict[str, Any]]:
    """Closing error of the circle under the end moment 2 pi EI / L."""
    for elements in ELEMENTS:
        rod = slender(elements)
        rod.solve_static(Loads(moment=2 * math.pi))
        error = math.hypot(*rod.state.pose[-1, :2])
        yield {"kind": "circle", "nodes": rod.nodes, "error": error}


def leg_rows() -> Iterator[dict[str, Any]]:
    """The tapered leg under 1 N at its tip; the error is over its length."""
    for shear in (True, False):
        tip = exact.leg_tip(shear)
        for elements in ELEMENTS:
            rod = CosseratRod(TPU, LEG, elements, shear=shear)
            rod.solve_static(PUSH)
            error = math.dist(rod.state.pose[-1, :2], tip) / LEG.length
            drop = -1e3 * rod.state.pose[-1, 1]
            yield {
                "kind": "leg", "shear": shear, "nodes": rod.nodes, "error": error, "tip_mm": drop
            }  # fmt: skip


def buckling_row(column: str, load: float, force: bool) -> dict[str, Any]:
    """Error of a column's critical load, at its tip (`force`) or its own weight, in percent."""
    rod, push = slender(STANDARD), (-COLUMN_OVERLOAD * load, 0.0)
    found = rod.solve_static(Loads(force=push) if force else Loads(gravity=push))
    error = abs(COLUMN_OVERLOAD * found.critical[0] - 1)
    return {"kind": "buckling", "column": column, "nodes": rod.nodes, "percent": 100 * error}


def frequency_rows() -> Iterator[dict[str, Any]]:
    """Errors of the first three clamped-free frequencies, in percent."""
    for elements in ELEMENTS:
        for name, wanted in exact.FREQUENCIES.items():
            if name == "leg":
                rod, unit = CosseratRod(TPU, LEG, elements, shear=False, rotary_inertia=False), 1.0
            else:
                rod, unit = slender(elements, 0.5 if name == "tapered" else 1.0), 2 * math.pi
            percent = 100 * np.abs(rod.natural_frequencies(3) * unit / wanted - 1)
            yield {"kind": "frequency", "rod": name, "nodes": rod.nodes, "percent": percent}


def static_checks(rows: list[dict[str, Any]]) -> list[Check]:
    """The goals at 31 nodes, and the order of convergence."""
    out: list[Check] = []
    for row in rows:
        if row.get("nodes") == 2 * STANDARD + 1:
            out += row_checks(row)
    for case in ("elastica", "follower force", "heavy elastica"):
        of_case = [row for row in rows if row["kind"] == case]
        largest = max(row["load"] for row in of_case)
        for last in (31, 129):
            found = order([row for row in of_case if row["load"] == largest], last)
            out.append(at_least(f"{case}'s order, 9 to {last} nodes", found, 2.0))
    for shear in (True, False):
        of_leg = [row for row in rows if row["kind"] == "leg" and row["shear"] is shear]
        name = f"leg's order {'with' if shear else 'without'} shear, 9 to 31 nodes"
        out.append(at_least(name, order(of_leg, 31), 2.0))
    return out


def row_checks(row: dict[str, Any]) -> Iterable[Check]:
    """The goals of one row at 31 nodes."""
    match row["kind"]:
        case "elastica" | "follower force" | "heavy elastica" as case:
            yield at_most(f"{case}, load {row['load']:g}", row["error"], 2e-4, "of the length")
        case "circle":
            yield at_most("circle, closing error", row["error"], 1e-6, "of the length")
        case "leg":
            name = f"leg {'with' if row['shear'] else 'without'} shear, 1 N"
            yield at_most(name, row["error"], 2e-4, "of the length")
        case "buckling":
            yield at_most(f"buckling load, {row['column']}", row["percent"], 0.5, "%")
        case "frequency":
            for mode, (percent, goal) in enumerate(zip(row["percent"], PERCENT), 1):
                yield at_most(f"frequency {mode}, {row['rod']}", percent, goal, "%")


def order(rows: list[dict[str, Any]], last: int) -> float:
    """Order of convergence between 9 and `last` nodes, against the modelled rod."""
    error = {row["nodes"]: row.get("discretisation", row["error"]) for row in rows}
    return math.log(error[9] / error[last]) / math.log((last - 1) / 8)
