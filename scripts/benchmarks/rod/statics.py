"""Static and vibration errors of the rod over its number of nodes."""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks.harness import Check, at_least, at_most, cpu_time
from benchmarks.rod import exact
from benchmarks.rod.exact import LEG, PUSH, THIN, THIN_MATERIAL, TPU
from slot_core.arrays import Array
from slot_core.rod.cosserat_rod import CosseratRod
from slot_core.rod.model import Geometry, Loads, Material, Rectangle, RodState, Uniform

NODES = (9, 17, 31, 61)
STANDARD, FINE = 31, 61  # nodes at which the goals are set: in the plane, and in space
PERCENT = 0.01  # goal of the frequencies' errors
COLUMN_OVERLOAD = 1.2  # of the load at which a column buckles

UNIT = Material(
    1.0, 1.0, 1e-6, 0.0
)  # L = EI = 1, EI sideways 2, GJ .8; stretch 1e-6 at load 1
OBLONG = Uniform(1e6, 1.0, 2.0, 0.8)
SPATIAL = {  # name: material, geometry and loads of cantilevers that bend in both planes and twist
    "oblique force": (UNIT, Geometry(1.0, OBLONG), Loads(force=(0.5, 2.0, 2.0))),
    "force against the tip": (
        UNIT,
        Geometry(1.0, OBLONG),
        Loads(force=(-1.0, 1.0, 3.0)),
    ),
    "sideways force, curved": (
        UNIT,
        Geometry(1.0, OBLONG, 1.0),
        Loads(force=(0.0, 2.0, 0.0)),
    ),
    "leg": (TPU, LEG, PUSH),
    "curved leg": (TPU, Geometry(LEG.length, LEG.section, 6.0), PUSH),
    "bend, 300": (exact.BEND_MATERIAL, exact.BEND, Loads(force=(0.0, 300.0, 0.0))),
    "bend, 600": (exact.BEND_MATERIAL, exact.BEND, Loads(force=(0.0, 600.0, 0.0))),
}


def slender(nodes: int, taper: float = 1.0) -> CosseratRod:
    """A rod with L = EI = rho A = 1 at its base."""
    return CosseratRod(
        THIN_MATERIAL, Geometry(1.0, Rectangle(1.0, (THIN, THIN * taper))), nodes
    )


def static_rows(repeats: int) -> Iterator[dict[str, Any]]:
    """Tips under loads, and buckling.

    `error` is against the exact case. `discretisation` is against collocation of the modelled rod,
    which stretches by 1e-6 of its length at load 10.
    """
    for p in (0.2, 1.0, 3.0, 10.0):
        loads = Loads(force=(0.0, 0.0, p))
        yield from tip_rows("elastica", p, loads, exact.elastica(p), repeats)
    for p in (1.0, 3.0, 10.0):
        loads = Loads(follower=(0.0, 0.0, p))
        yield from tip_rows("follower force", p, loads, exact.follower(p), repeats)
    for w in (1.0, 10.0, 50.0):
        loads = Loads(gravity=(0.0, 0.0, -w))
        yield from tip_rows("heavy elastica", w, loads, exact.heavy(w), repeats)
    for nodes in NODES:  # a circle, by the end moment 2 pi EI / L: its closing error
        rod = slender(nodes)
        rod.solve_static(Loads(moment=(0.0, 2 * math.pi, 0.0)))
        yield {"kind": "circle", "nodes": nodes, "error": math.hypot(*rod.tip.position)}
    yield from spatial_rows()
    yield from published_rows()
    yield from buckling_rows()


def tip_rows(
    case: str, load: float, loads: Loads, tip: Array, repeats: int
) -> Iterator[dict[str, Any]]:
    """Tip errors of a cantilever that bends in the plane, over the number of nodes."""
    modelled = exact.thin(loads)
    for nodes in NODES:
        rod = slender(nodes)
        rest = rod.state

        def solve(rod: CosseratRod = rod, rest: RodState = rest) -> None:
            rod.state = rest
            rod.solve_static(loads)

        cpu = cpu_time(solve, repeats)
        reached = np.array(rod.tip.position)[[0, 2]]
        yield {
            "kind": case,
            "load": load,
            "nodes": nodes,
            "error": math.dist(reached, tip),
            "discretisation": math.dist(reached, modelled),
            "cpu_ms": 1e3 * cpu,
        }


def spatial_rows() -> Iterator[dict[str, Any]]:
    """Tip errors over the length of cantilevers that bend in both planes and twist."""
    for case, (material, geometry, loads) in SPATIAL.items():
        wanted = exact.tip(material, geometry, loads)
        for refined in (True, False):
            for nodes in NODES:
                rod = CosseratRod(material, geometry, nodes, refined=refined)
                rod.solve_static(loads)
                error = math.dist(rod.tip.position, wanted) / geometry.length
                yield {
                    "kind": "spatial",
                    "case": case,
                    "refined": refined,
                    "nodes": nodes,
                    "error": error,
                }


def published_rows() -> Iterator[dict[str, Any]]:
    """Largest difference from the published displacements of Princeton's beam and the bend, %."""
    beam, bend, cases = exact.PRINCETON_MATERIAL, exact.BEND_MATERIAL, []
    for degrees, tip in exact.PRINCETON_TIPS.items():
        angle, force = math.radians(degrees), exact.PRINCETON_FORCE
        rod = CosseratRod(beam, exact.PRINCETON, STANDARD)
        load = (0.0, force * math.cos(angle), force * math.sin(angle))
        cases.append(
            (f"Princeton's beam at {degrees} deg", rod, load, (math.nan, *tip))
        )
    for force, tip in exact.BEND_TIPS.items():
        rod = CosseratRod(bend, exact.BEND, STANDARD)
        name = f"Bathe and Bolourchi's bend at {force:g}"
        cases.append((name, rod, (0.0, force, 0.0), tip))
    for case, rod, load, wanted in cases:
        rod.solve_static(Loads(force=load))
        pairs = [(a, b) for a, b in zip(rod.tip.position, wanted) if b]
        percent = np.nanmax([100 * abs(a / b - 1) for a, b in pairs])
        yield {"kind": "published", "case": case, "percent": percent}


def buckling_rows() -> Iterator[dict[str, Any]]:
    """Errors of critical loads, in percent: of columns under a tip force and their own weight.

    The last one is a cantilever, stiff in the plane of its tip force, that buckles sideways.
    """
    over, stiff = COLUMN_OVERLOAD, Geometry(1.0, Uniform(1e6, 1e4, 1.0, 0.8))
    aside = Loads(force=(0.0, 0.0, over * exact.LATERAL * math.sqrt(0.8)))
    for column, rod, loads in (
        (
            "Euler's column",
            slender(STANDARD),
            Loads(force=(-over * exact.EULER, 0.0, 0.0)),
        ),
        (
            "heavy column",
            slender(STANDARD),
            Loads(gravity=(-over * exact.GREENHILL, 0.0, 0.0)),
        ),
        ("sideways", CosseratRod(UNIT, stiff, STANDARD), aside),
    ):
        percent = 100 * abs(over * rod.solve_static(loads).critical[0] - 1)
        yield {
            "kind": "buckling",
            "column": column,
            "nodes": rod.nodes,
            "percent": percent,
        }


def frequency_rows() -> Iterator[dict[str, Any]]:
    """Errors of the first clamped-free frequencies of a kind, in percent."""
    wanted = {
        **{
            name: found / (1.0 if name == "leg" else 2 * math.pi)
            for name, found in exact.FREQUENCIES.items()
        },
        "leg, sideways": exact.sideways(TPU, LEG, 3),
        "leg, twist": exact.twisting(TPU, LEG, 1),
    }
    for nodes in NODES:
        for name, frequencies in wanted.items():
            rod = CosseratRod(TPU, LEG, nodes)
            if not name.startswith("leg"):
                rod = slender(nodes, 0.5 if name == "tapered" else 1.0)
            found = rod.natural_frequencies(20)
            percent = [100 * np.abs(found / f - 1).min() for f in frequencies]
            yield {
                "kind": "frequency",
                "rod": name,
                "nodes": nodes,
                "percent": np.array(percent),
            }


def static_checks(rows: list[dict[str, Any]]) -> list[Check]:
    """The goals at the standard numbers of nodes, and the order of convergence."""
    out: list[Check] = []
    for row in rows:
        match row["kind"], row.get("nodes"):
            case ("elastica" | "follower force" | "heavy elastica") as kind, nodes if (
                nodes == STANDARD
            ):
                name = f"{kind}, load {row['load']:g}"
                out.append(at_most(name, row["error"], 2e-4, "of the length"))
            case "circle", nodes if nodes == STANDARD:
                out.append(
                    at_most(
                        "circle, closing error", row["error"], 1e-4, "of the length"
                    )
                )
            case "spatial", nodes if nodes == FINE and row["refined"]:
                name = f"{row['case']}, {FINE} nodes"
                out.append(at_most(name, row["error"], 1e-6, "of the length"))
            case "published", _:
                out.append(at_most(row["case"], row["percent"], 1.0, "%"))
            case "buckling", _:
                name = f"buckling load, {row['column']}"
                out.append(at_most(name, row["percent"], 0.1, "%"))
            case "frequency", nodes if nodes == FINE:
                out += [
                    at_most(f"frequency {mode}, {row['rod']}", percent, PERCENT, "%")
                    for mode, percent in enumerate(row["percent"], 1)
                ]
    for kind in ("elastica", "follower force", "heavy elastica"):
        of_case = [row for row in rows if row["kind"] == kind]
        largest = max(row["load"] for row in of_case)
        found = order([row for row in of_case if row["load"] == largest], 9, STANDARD)
        out.append(at_least(f"{kind}'s order, 9 to {STANDARD} nodes", found, 2.0))
    refined = [row for row in rows if row["kind"] == "spatial" and row["refined"]]
    for name in SPATIAL:
        found = order([row for row in refined if row["case"] == name], 17, FINE)
        out.append(at_least(f"{name}: order, 17 to {FINE} nodes", found, 2.5))
    return out


def order(rows: list[dict[str, Any]], first: int, last: int) -> float:
    """Order of convergence between two numbers of nodes, against the modelled rod."""
    error = {row["nodes"]: row.get("discretisation", row["error"]) for row in rows}
    return math.log(error[first] / error[last]) / math.log((last - 1) / (first - 1))
