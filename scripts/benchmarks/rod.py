"""Accuracy and speed of the Cosserat rod: statics, vibration, conservation and a release test.

Errors of statics are of the tip over the length, against elliptic integrals and published figures.
The release test: the leg (clamped, no gravity, Kelvin-Voigt damping) is bent by 1 N at its tip and
let go; the error is the root mean square of the tip's distance from a fine solution over 1 s, over
the initial deflection, each rod against its own physics. MuJoCo's hinge chain runs as a peer where
the package `mujoco` is installed.
"""

import importlib.util
import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from scipy.integrate import solve_bvp
from scipy.optimize import brentq, fsolve
from scipy.special import ellipe, ellipeinc, ellipk, ellipkinc

from slot_core.dynamics.cosserat import CosseratRod, DivergenceError, Scheme, State
from slot_core.dynamics.cosserat_model import (
    FREE,
    RIGID_IN_SHEAR,
    Geometry,
    Loads,
    Material,
    Rectangle,
)
from slot_core.evaluation import palette
from slot_core.evaluation.benchmark import Check, Row, at_least, at_most, cpu_time
from slot_core.robot import Array

ELEMENTS = (4, 8, 15, 32, 64)  # 9 .. 129 nodes
STANDARD = 15  # elements, 31 nodes, at which the goals are set
THIN = 1e-3  # thickness over length: with EI = L = 1 the elastica, stretched by 1e-7
THIN_MATERIAL = Material(12 / THIN**3, 4 / THIN**3, 1 / THIN, 0.0)
LEG = Geometry(0.19, Rectangle(0.02, (0.0135, 0.0035)))
TPU = Material(1e7, 1e7 / 3, 1200.0, 5e-4)
PUSH = Loads(force=(0.0, -1.0))
DURATION, SAMPLES = 1.0, 100  # s of the release test
PARTS = {"uniform": (0.1, 0.3, 0.6), "tapered": (0.1, 0.3, 0.6), "leg": (0.1, 0.3, 0.6)}  # percent
FREQUENCIES = {  # rad/s with EI = rho A = L = 1; the leg's in Hz
    "uniform": np.array([1.8751040687, 4.6940911330, 7.8547574382]) ** 2,
    "tapered": np.array([3.8237848473, 18.3172609042, 47.2648270105]),
    "leg": np.array([6.5209720302, 25.5124367433, 61.3511026964]),
}
LARGEST_COST, LARGEST_ERROR = 0.0025, 0.5  # CPU s per simulated s; percent

CHECKED_NODES = (7, 31)  # the fewest within the goal at any smaller step, and the standard
PEER_STEPS = (1e-3, 5e-4, 2e-4)  # at 2 ms MuJoCo's chain is unstable
PEER_LINKS = (10, 20, 30, 60)


def run(quick: bool, out: Path, progress: Callable[[str], None]) -> tuple[list[Row], list[Check]]:
    """Measure; the picture of the release test goes to `out/rod.png`."""
    repeats = 3 if quick else 9
    progress("statics")
    rows: list[dict[str, Any]] = [*elastica_rows(repeats), *circle_rows(), buckling_row()]
    progress("vibration and free flight")
    rows += [*frequency_rows(), *flight_rows()]
    for shear in (False, True):
        progress(f"release test {'with' if shear else 'without'} shear")
        rows += release_rows(shear, quick, repeats)
    if importlib.util.find_spec("mujoco"):
        progress("release test of MuJoCo's hinge chain")
        rows += peer_rows(repeats)
    released = [row for row in rows if row["kind"] == "release"]
    mark_front(released)
    draw(released, out / "rod.png")
    return rows, checks(rows)


def slender(elements: int, taper: float = 1.0, **options: Any) -> CosseratRod:
    """A rod with L = EI = rho A = 1 at its base, without shear and rotary inertia."""
    geometry = Geometry(1.0, Rectangle(1.0, (THIN, THIN * taper)))
    return CosseratRod(
        THIN_MATERIAL, geometry, elements, shear=False, rotary_inertia=False, **options
    )


def bisshopp_drucker(p: float) -> Array:
    """Tip (x, y) / L of the inextensible cantilever under P L^2/(EI) = p."""

    def excess(angle: float) -> float:
        m = (1 + math.sin(angle)) / 2
        return float(ellipk(m) - ellipkinc(math.asin(math.sqrt(0.5 / m)), m)) - math.sqrt(p)

    angle = brentq(excess, 1e-12, math.pi / 2 - 1e-12, xtol=1e-14)
    m = (1 + math.sin(angle)) / 2
    second = ellipe(m) - ellipeinc(math.asin(math.sqrt(0.5 / m)), m)
    return np.array([math.sqrt(2 * math.sin(angle) / p), 1 - 2 * second / math.sqrt(p)])


def modelled_tip(p: float) -> Array:
    """Tip of the same cantilever with the stretch and the stiff shear of the rod, by collocation.

    n = (0, p); angle' = M, r' = R (1 + n.t / EA, n.d / GA), M' = -r' x n; EI = L = 1.
    """
    axial, shear = THIN_MATERIAL.young_modulus * THIN, RIGID_IN_SHEAR

    def slope(s: Array, y: Array) -> Array:
        cos, sin = np.cos(y[0]), np.sin(y[0])
        along, across = 1 + p * sin / axial, p * cos / shear
        x, z = cos * along - sin * across, sin * along + cos * across
        return np.array([y[1], -p * x, x, z])

    def ends(a: Array, b: Array) -> Array:
        return np.array([a[0], b[1], a[2], a[3]])

    s = np.linspace(0.0, 1.0, 401)
    guess = np.array([s, 1 - s, s, s**2 / 2])
    solution = solve_bvp(slope, ends, s, guess, tol=1e-12, max_nodes=100_000)
    tip: Array = solution.y[2:, -1]
    return tip


def elastica_rows(repeats: int) -> Iterable[dict[str, Any]]:
    """The cantilever under a dead load, N and load."""
    for p in (0.2, 1.0, 3.0, 10.0):
        exact, modelled = bisshopp_drucker(p), modelled_tip(p)
        loads = Loads(force=(0.0, p))
        for elements in ELEMENTS:
            rod = slender(elements)
            rest = rod.state
            found = rod.solve_static(loads)
            error = math.dist(rod.state.pose[-1, :2], exact)

            def solve(rod: CosseratRod = rod, rest: State = rest, loads: Loads = loads) -> None:
                rod.state = rest
                rod.solve_static(loads)

            yield {
                "kind": "elastica",
                "load": p,
                "nodes": rod.nodes,
                "error": error,
                "discretisation": math.dist(rod.state.pose[-1, :2], modelled),
                "iterations": found.iterations,
                "cpu_ms": 1e3 * cpu_time(solve, repeats).median,
            }


def circle_rows() -> Iterable[dict[str, Any]]:
    """The end moment 2 pi EI / L."""
    for elements in ELEMENTS:
        rod = slender(elements)
        rod.solve_static(Loads(moment=2 * math.pi))
        error = math.hypot(*rod.state.pose[-1, :2])
        yield {"kind": "circle", "nodes": rod.nodes, "error": error}


def buckling_row() -> dict[str, Any]:
    """Euler's load of the clamped column over the exact one."""
    rod, exact = slender(STANDARD), math.pi**2 / 4
    found = rod.solve_static(Loads(force=(-1.2 * exact, 0.0)))
    error = abs(1.2 * found.critical[0] - 1)
    return {"kind": "buckling", "nodes": rod.nodes, "percent": 100 * error}


def frequency_rows() -> Iterable[dict[str, Any]]:
    """Clamped-free frequencies over the exact ones."""
    for elements in ELEMENTS:
        for name, exact in FREQUENCIES.items():
            if name == "leg":
                rod, unit = CosseratRod(TPU, LEG, elements, shear=False, rotary_inertia=False), 1.0
            else:
                rod, unit = slender(elements, 0.5 if name == "tapered" else 1.0), 2 * math.pi
            percent = 100 * np.abs(rod.natural_frequencies(3) * unit / exact - 1)
            yield {"kind": "frequency", "rod": name, "nodes": rod.nodes, "percent": percent}


def flight_rows() -> Iterable[dict[str, Any]]:
    """An undamped leg that is thrown, spins and vibrates for a second."""
    for theta in (0.5, 0.55):
        for h in (1e-3, 5e-4, 2.5e-4):
            rod = thrown(Scheme(theta=theta, tolerance=1e-13))
            momentum, energy, drift = np.array(rod.momentum()), rod.energy().total, 0.0
            for _ in range(50):
                rod.run(h, round(0.02 / h))
                drift = max(drift, abs(rod.energy().total / energy - 1))
            change = np.abs(np.array(rod.momentum()) / momentum - 1).max()
            yield {"kind": "flight", "theta": theta, "h": h, "momentum": change, "energy": drift}


def thrown(scheme: Scheme) -> CosseratRod:
    """The leg without damping in flight: 8 rad/s, 0.4 m/s, and a velocity that bends it."""
    material = Material(TPU.young_modulus, TPU.shear_modulus, TPU.density, 0.0)
    rod = CosseratRod(material, LEG, 8, base=FREE, scheme=scheme)
    pose = rod.state.pose
    velocity = 8.0 * np.column_stack([-pose[:, 1], pose[:, 0], np.ones(len(pose))])
    velocity[:, 0] += 0.3
    velocity[:, 1] += 60.0 * (pose[:, 0] - 0.1) ** 2 - 0.2
    rod.state = State(pose, velocity)
    return rod


def release_rows(shear: bool, quick: bool, repeats: int) -> list[dict[str, Any]]:
    """The release test over N, step and scheme."""
    exact = fine_release(shear)
    schemes = [(0.5, 1), (0.5, 2), (0.5, 20), (0.55, 2)]
    steps = [2e-3, 1e-3, 5e-4] if quick else [2e-3, 1e-3, 5e-4, 2.5e-4]
    return [
        release_row(shear, elements, h, theta, iterations, exact, repeats)
        for elements in (3, 4, 6, 8, 15)
        for h in steps
        for theta, iterations in schemes
    ]


def release_row(  # noqa: PLR0917
    shear: bool,
    elements: int,
    h: float,
    theta: float,
    iterations: int,
    exact: Array,
    repeats: int,
) -> dict[str, Any]:
    """One release; the error is NaN where the scheme diverges."""
    rod, bent = leg(elements, shear, Scheme(theta, iterations))
    deflection = math.dist(bent.pose[-1, :2], (LEG.length, 0.0))
    error, cost = math.nan, math.nan
    steps = round(DURATION / h)

    def release() -> Array:
        rod.state = bent
        return rod.run(h, steps, samples=SAMPLES)

    try:
        error = deviation(release()[:, :2], exact) / deflection
        cost = cpu_time(release, repeats).median / DURATION
    except DivergenceError:
        pass
    return {
        "kind": "release",
        "model": "shear" if shear else "no shear",
        "nodes": rod.nodes,
        "h": h,
        "theta": theta,
        "iterations": iterations,
        "percent": 100 * error,
        "cpu_s": cost,
    }


def leg(elements: int, shear: bool, scheme: Scheme) -> tuple[CosseratRod, State]:
    """The leg and its state under the push."""
    rod = CosseratRod(TPU, LEG, elements, shear=shear, rotary_inertia=shear, scheme=scheme)
    rod.solve_static(PUSH)
    return rod, rod.state


def fine_release(shear: bool) -> Array:
    """(SAMPLES, 2) tip of 41 nodes, extrapolated from steps of 40 and 20 us."""
    ways = []
    for h in (4e-5, 2e-5):
        rod, _ = leg(20, shear, Scheme(tolerance=1e-11))
        ways.append(rod.run(h, round(DURATION / h), samples=SAMPLES)[:, :2])
    return ways[1] + (ways[1] - ways[0]) / 3


def deviation(tip: Array, exact: Array) -> float:
    """Root mean square of the distance, m."""
    return float(np.sqrt(((tip - exact) ** 2).sum(axis=1).mean()))


def peer_rows(repeats: int) -> Iterable[dict[str, Any]]:
    """MuJoCo: links that turn in the plane, springs and dampers as stiff as the leg."""
    exact = fine_release(shear=False)
    for links, h in itertools.product(PEER_LINKS, PEER_STEPS):
        tip, deflection, cost = hinge_chain(links, h, repeats)
        yield {
            "kind": "release",
            "model": "MuJoCo hinge chain",
            "nodes": links + 1,
            "h": h,
            "percent": 100 * deviation(tip, exact) / deflection,
            "cpu_s": cost,
        }


def hinge_chain(links: int, h: float, repeats: int) -> tuple[Array, float, float]:
    """(SAMPLES, 2) tip of the released chain, its initial deflection, CPU s per second."""
    import mujoco  # noqa: PLC0415 - a peer, not needed otherwise

    spring = chain_springs(links)
    model = mujoco.MjModel.from_xml_string(chain_description(h, spring))
    data, bent = mujoco.MjData(model), chain_equilibrium(spring)
    every = round(DURATION / h) // SAMPLES
    tip = np.zeros((SAMPLES, 2))

    def release() -> None:
        mujoco.mj_resetData(model, data)
        data.qpos[:] = bent
        for sample in tip:
            mujoco.mj_step(model, data, every)
            mujoco.mj_kinematics(model, data)
            sample[:] = data.site_xpos[0, [0, 2]]

    release()
    if any(warning.number for warning in data.warning):  # it resets itself where it diverges
        tip[:] = np.nan
    cost = cpu_time(release, repeats).median / DURATION
    angle = -np.cumsum(bent)
    start = LEG.length / links * np.array([np.cos(angle).sum(), np.sin(angle).sum()])
    return tip, math.dist(start, (LEG.length, 0.0)), cost


def chain_springs(links: int) -> Array:
    """(links,) N m/rad; the first half cell bends between the clamp and the first link."""
    at = np.arange(links) / links
    at[0] = 0.25 / links
    extent = np.full(links, LEG.length / links)
    extent[0] /= 2
    return TPU.young_modulus * LEG.section.second_moment(at) / extent


def chain_equilibrium(spring: Array) -> Array:
    """Hinge angles under the push; positive turns x towards -z."""

    link = LEG.length / len(spring)

    def moments(turn: Array) -> Array:
        angle = -np.cumsum(turn)
        arm = np.cumsum((link * np.cos(angle))[::-1])[::-1]  # from each hinge to the tip
        return spring * turn + arm * PUSH.force[1]

    solution: Array = fsolve(moments, np.zeros(len(spring)), xtol=1e-12)
    return solution


def chain_description(h: float, spring: Array) -> str:
    """The chain as MuJoCo reads it."""
    links, link = len(spring), LEG.length / len(spring)
    middle = (np.arange(links) + 0.5) / links
    mass = TPU.density * LEG.section.area(middle) * link
    body = f'<site name="tip" pos="{link} 0 0" size="0.001"/>'
    for i in reversed(range(links)):
        thick = mass[i] / (TPU.density * 0.02 * link)
        body = (
            f'<body pos="{link if i else 0} 0 0"><joint type="hinge" axis="0 1 0" '
            f'stiffness="{spring[i]}" damping="{spring[i] * TPU.damping_time}"/>'
            f'<geom type="box" size="{link / 2} 0.01 {thick / 2}" pos="{link / 2} 0 0" '
            f'mass="{mass[i]}" contype="0" conaffinity="0"/>{body}</body>'
        )
    option = f'<option timestep="{h}" integrator="implicitfast" gravity="0 0 0"/>'
    return f'<mujoco><compiler angle="radian"/>{option}<worldbody>{body}</worldbody></mujoco>'


def mark_front(rows: list[dict[str, Any]]) -> None:
    """Mark the rows of which no other of this project is both faster and more exact."""
    own = [row for row in rows if "MuJoCo" not in row["model"] and row["percent"] < math.inf]
    for row in rows:
        row["front"] = row in own and not any(
            other["cpu_s"] < row["cpu_s"] and other["percent"] < row["percent"] for other in own
        )


def checks(rows: list[dict[str, Any]]) -> list[Check]:
    """The figures against the goals."""
    elastica = [row for row in rows if row["kind"] == "elastica"]
    standard = [row for row in rows if row.get("nodes") == 2 * STANDARD + 1]
    out = [
        at_most(f"elastica at 31 nodes, load {row['load']:g}", row["error"], 2e-4, "of the length")
        for row in standard
        if row["kind"] == "elastica"
    ]
    for last in (31, 129):
        order = min(elastica_order(elastica, load, last) for load in (3.0, 10.0))
        out.append(at_least(f"elastica's order, 9 to {last} nodes, loads 3 and 10", order, 2.0))
    for row in standard:
        if row["kind"] == "circle":
            out.append(at_most("circle does not close by", row["error"], 1e-6, "of the length"))
        if row["kind"] == "buckling":
            out.append(at_most("buckling load", row["percent"], 0.5, "%"))
        if row["kind"] == "frequency":
            for mode, (percent, goal) in enumerate(zip(row["percent"], PARTS[row["rod"]]), 1):
                out.append(at_most(f"frequency {mode}, {row['rod']}", percent, goal, "%"))
    flight = [row["momentum"] for row in rows if row["kind"] == "flight" and row["theta"] == 0.5]
    out.append(at_most("momentum in flight, midpoint rule", max(flight), 1e-10, "of itself"))
    return out + release_checks([row for row in rows if row["kind"] == "release"])


def elastica_order(rows: list[dict[str, Any]], load: float, last: int) -> float:
    """Slope of the error over N between 9 and `last` nodes, against the rod as it is modelled.

    The elastica itself neither stretches nor shears: 1e-6 of the length at load 10.
    """
    error = {row["nodes"]: row["discretisation"] for row in rows if row["load"] == load}
    return math.log(error[9] / error[last]) / math.log((last - 1) / 8)


def release_checks(rows: list[dict[str, Any]]) -> list[Check]:
    """The release test at settings named beforehand, and the distance from the peer.

    Not the best of all rows: where errors of space and time cancel, that would be luck.
    """
    out = []
    for nodes in CHECKED_NODES:
        for model in ("no shear", "shear"):
            row = setting(rows, model, nodes)
            name = f"release, {nodes} nodes, 1 ms, 2 iterations, {model}"
            out.append(at_most(f"{name}: error", row["percent"], LARGEST_ERROR, "%"))
            out.append(at_most(f"{name}: cost", row["cpu_s"], LARGEST_COST, "CPU s per s"))
    peers = [row for row in rows if "MuJoCo" in row["model"]]
    own = setting(rows, "no shear", CHECKED_NODES[0])
    for percent in (LARGEST_ERROR, 1.0) if peers else ():
        rivals = [row["cpu_s"] for row in peers if row["percent"] <= percent]
        ahead = min(rivals, default=math.inf) / own["cpu_s"]
        out.append(at_least(f"times faster than MuJoCo within {percent:g} %", ahead, 3.0))
    return out


def setting(rows: list[dict[str, Any]], model: str, nodes: int) -> dict[str, Any]:
    """The row of the midpoint rule at 1 ms with two iterations."""
    wanted = {"model": model, "nodes": nodes, "h": 1e-3, "theta": 0.5, "iterations": 2}
    return next(row for row in rows if wanted.items() <= row.items())


def draw(rows: list[Mapping[str, Any]], path: Path) -> None:
    """Error over cost of the release test, the Pareto front as a line."""
    figure = Figure(figsize=(8, 5.5), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    nodes = sorted({row["nodes"] for row in rows if "MuJoCo" not in row["model"]})
    colour = dict(zip(nodes, [*palette.STAGE_COLOURS, palette.TRUE]))
    for row in rows:
        if not row["percent"] < math.inf:
            continue
        peer = "MuJoCo" in row["model"]
        mark = "X" if peer else {1: "o", 2: "s", 20: "D"}[row["iterations"]]
        if row.get("theta", 0.5) > 0.5:
            mark = "v"
        edge = palette.INK if peer else colour[row["nodes"]]
        face = edge if row["model"] != "no shear" else "none"
        ax.scatter(
            row["cpu_s"], row["percent"], 30, marker=mark, edgecolors=edge,
            facecolors=face, linewidths=1.0,
        )  # fmt: skip
    front = sorted((row["cpu_s"], row["percent"]) for row in rows if row["front"])
    ax.step(*zip(*front), where="post", color=palette.PALE, zorder=0, label="Pareto front")
    goal = ([1e-9, LARGEST_COST, LARGEST_COST], [LARGEST_ERROR, LARGEST_ERROR, 1e-9])
    ax.plot(*goal, color=palette.INK, lw=0.7, ls=":", label="goal")
    legend(ax, colour)
    ax.set(
        xscale="log", yscale="log", xlim=(3e-4, 0.1), ylim=(5e-3, 10),
        xlabel="CPU seconds per simulated second", ylabel="error of the tip, % of deflection",
        title="Release of the leg: filled with shear, open without",
    )  # fmt: skip
    figure.savefig(path, dpi=150)


def legend(ax: Any, colour: Mapping[int, str]) -> None:
    """Names of colours and marks."""
    for nodes, name in colour.items():
        ax.plot([], [], "o", color=name, label=f"{nodes} nodes")
    names = {
        "o": "midpoint, 1 iteration",
        "s": "midpoint, 2",
        "D": "midpoint, converged",
        "v": "theta 0.55, 2",
        "X": "MuJoCo hinge chain",
    }
    for mark, name in names.items():
        ax.plot([], [], mark, color=palette.INK, mfc="none", label=name)
    ax.legend(fontsize=8, ncols=2, loc="upper right", frameon=False)
