"""Accuracy and speed of the whole robot: every integrator, number of nodes, step and model level.

The test is to stand up and step: natural legs on the floor, tendons pulled to 63 deg, after half a
second to 90, 30, 50 and 75 deg, 1.5 s in all. The error is the root mean square of the distance of
the torso's centre from a fine solution (121 nodes, 10 us, converged). The robot is also
compared with the same robot in MuJoCo (other_engine.py), and the nominal robot of the controller
with it (nominal_prediction.py).
"""

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import (
    Check,
    Outcome,
    Progress,
    Row,
    at_most,
    cpu_ratio,
    cpu_time,
    mark_front,
)
from benchmarks.plots import CostCurve, draw_error_over_cost
from benchmarks.robot import nominal_prediction, other_engine
from benchmarks.rod.release import DAMPED
from slot_core import config
from slot_core.arrays import Array
from slot_core.config import ConfigError
from slot_core.drawing import palette
from slot_core.dynamics.scene import level_changes, read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.refusal import DivergenceError
from slot_core.robot import RobotParameters, read_robot
from slot_core.rod.model import Scheme
from slot_core.simulation.make_robot import make_robot
from slot_core.simulation.rod_robot import RodRobot

REQUIRES = ("mujoco",)
# s, deg
COMMANDS = ((0.5, (63.0, 63.0, 63.0, 63.0)), (1.0, (90.0, 30.0, 50.0, 75.0)))
DURATION = sum(seconds for seconds, _ in COMMANDS)
SAMPLE = 0.01  # s
FINE = {"nodes": 121, "step": 1e-5, "theta": 0.5, "iterations": 3}
SCHEMES = (
    (0.5, 1),
    (0.5, 2),
    (0.55, 1),
    (0.55, 2),
    (0.55, 4),
    (1.0, 1),
    (1.0, 2),
)
NODES = (7, 10, 16, 22, 31, 61)
STEPS = (5e-3, 2e-3, 1e-3, 5e-4, 2.5e-4)
LEVELS = ("map", "coarse", "standard", "fine")
LARGEST_ERROR = 0.3  # mm
# A step of the robot, two iterations of four legs in lanes, over a step of one public rod with as
# many nodes and two iterations: no more than of four such rods.
LARGEST_RATIO = 4.0
COMPARED = (22, 31)  # nodes
# of a step in calls of four, as the closed loop makes, over one in a call of a thousand
CALL_RATIO = 1.18


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Run all tests; plots of error over cost and of the other engine go to `out`."""
    robot, repeats = read_robot(), 3 if quick else 9
    progress("cost of a step")
    rows: list[dict[str, Any]] = [
        cost_row(robot, nodes, repeats) for nodes in (10, 16, 22, 31, 61)
    ]
    progress("fine reference")
    exact = motion(simulator(robot, FINE))
    moved = [*sweep(robot, exact, repeats, quick, progress)]
    progress("model levels")
    moved += [level_row(robot, name, exact, repeats) for name in LEVELS]
    mark_front(moved, "us_per_ms", itemgetter("error_mm"))
    draw(moved, out / "robot.png")
    rows += moved
    compared = other_engine.rows(quick, out, progress)
    found = nominal_prediction.rows(quick, progress)
    return [*rows, *compared, *found], [
        *checks(rows),
        *other_engine.checks(compared),
        *nominal_prediction.checks(found),
    ]


def draw(rows: Sequence[Row], path: Path) -> None:
    """Write the plot of error over cost: schemes, nodes and steps, and the model levels."""
    moved = [row for row in rows if row["kind"] in ("stand and step", "level")]
    places = [(row["us_per_ms"], row["error_mm"], "") for row in moved]
    front = [place for place, row in zip(places, moved) if row["front"]]
    name = "best of all schemes, nodes, steps"
    series = [CostCurve(name, "o", palette.TORSO, places, front)]
    for row in moved:
        if row["kind"] == "level" and row["error_mm"] < math.inf:
            name = f"level {row['level']}: {1e3 * row['step']:g} ms"
            name += f", {row['nodes']} nodes" * (row["level"] != "map")
            colour = palette.STAGE_COLOURS[LEVELS.index(row["level"])]
            place = (row["us_per_ms"], row["error_mm"], row["level"])
            series.append(CostCurve(name, "D", colour, (), [place]))
    draw_error_over_cost(
        series,
        path,
        xlim=(0.3, 300),
        ylim=(0.006, 30),
        xlabel="CPU microseconds per simulated millisecond, whole robot",
        ylabel="error of the torso's centre, mm RMS",
        title="Stand up and step, 1.5 s: error against 121 nodes at 10 us",
    )


def simulator(
    robot: RobotParameters, solver: dict[str, Any], **changes: Any
) -> RodRobot:
    """RodRobot in the scene `flat` without settling, with changes of the solver and the scene."""
    values = {f"solver.{name}": value for name, value in solver.items()}
    return RodRobot(
        robot,
        config.replace(
            read_scene("flat"), {"start.settle": 0.0} | values | changes
        ),
        read_servo(),
    )


def motion(sim: SimulatedRobot) -> Array:
    """(n, 3) m, the torso's centre every `SAMPLE` through COMMANDS."""
    every = round(SAMPLE / sim.scene.solver.step)
    path = []
    for seconds, degrees in COMMANDS:
        for _ in range(round(seconds / SAMPLE)):
            sim.advance(every, np.radians(degrees))
            path.append(sim.position)
    return np.array(path)


def run_through(sim: SimulatedRobot) -> None:
    """The same motion in two calls, for timing."""
    for seconds, degrees in COMMANDS:
        sim.advance(round(seconds / sim.scene.solver.step), np.radians(degrees))


def deviation(path: Array, exact: Array) -> float:
    """Root mean square of the distance between paths (n, 3), mm."""
    return 1e3 * float(np.sqrt(((path - exact) ** 2).sum(axis=1).mean()))


def cost_row(
    robot: RobotParameters, nodes: int, repeats: int
) -> dict[str, Any]:
    """CPU time of a step of the standing robot, with contact, friction, corners and servos."""
    sim, calls = (
        simulator(robot, {"nodes": nodes}, **{"start.settle": 1.0}),
        1000,
    )

    def advance() -> None:
        sim.advance(calls, sim.tendon_angle)

    time = cpu_time(advance, repeats) / calls
    step = sim.scene.solver.step
    row = {
        "kind": "cost",
        "nodes": nodes,
        "us_per_step": 1e6 * time,
        "real_time": step / time,
    }
    if nodes in COMPARED:
        rod, _ = DAMPED.leg(nodes, Scheme(0.5, 2))
        row["over_rod"] = cpu_ratio(
            advance, lambda: rod.run(step, calls), repeats
        )
        row["in_calls"] = cpu_ratio(
            lambda: [
                sim.advance(4, sim.tendon_angle) for _ in range(calls // 4)
            ],
            advance,
            repeats,
        )
    return row


def sweep(
    robot: RobotParameters,
    exact: Array,
    repeats: int,
    quick: bool,
    progress: Progress,
) -> Iterator[dict[str, Any]]:
    """Stand and step over schemes, numbers of nodes and time steps."""
    steps, numbers = (STEPS[1:-1], COMPARED) if quick else (STEPS, NODES)
    for theta, iterations in SCHEMES:
        progress(f"stand and step: theta {theta}, {iterations} iterations")
        for nodes, step in itertools.product(numbers, steps):
            solver = {
                "nodes": nodes,
                "step": step,
                "theta": theta,
                "iterations": iterations,
            }
            yield (
                {"kind": "stand and step"}
                | solver
                | measured(
                    functools.partial(simulator, robot, solver), exact, repeats
                )
            )


def measured(
    make: Callable[[], SimulatedRobot], exact: Array, repeats: int
) -> dict[str, Any]:
    """Error and cost of stand and step; NaN if the simulation diverges."""
    try:
        sim = make()
        error = deviation(motion(sim), exact)
        again = [make() for _ in range(repeats + 1)]
        time = cpu_time(lambda: run_through(again.pop()), repeats)
    except (DivergenceError, ConfigError) as reason:
        return {
            "error_mm": math.nan,
            "us_per_ms": math.nan,
            "lost": str(reason),
        }
    return {
        "error_mm": error,
        "us_per_ms": 1e6 * time / DURATION * 1e-3,
        "halvings": sim.halvings,
    }


def level_row(
    robot: RobotParameters, name: str, exact: Array, repeats: int
) -> dict[str, Any]:
    """Stand and step at the level of `config/solver/<name>.yaml`."""
    changes = {"start.settle": 0.0} | level_changes(name)
    scene = config.replace(read_scene("flat"), changes)
    return {
        "kind": "level",
        "level": name,
        "nodes": scene.solver.nodes,
        "step": scene.solver.step,
        **measured(
            lambda: make_robot(robot, scene, read_servo()), exact, repeats
        ),
    }


def checks(rows: list[dict[str, Any]]) -> list[Check]:
    """The figures against the goals."""
    out = []
    for row in rows:
        if row["kind"] == "cost" and "over_rod" in row:
            step = f"step of {row['nodes']} nodes"
            out += [
                at_most(
                    f"{step} over one public rod",
                    row["over_rod"],
                    LARGEST_RATIO,
                ),
                at_most(
                    f"{step}, calls of four over one call",
                    row["in_calls"],
                    CALL_RATIO,
                ),
            ]
        if row["kind"] == "level" and row["level"] == "standard":
            name = "stand and step: 22 nodes, 1 ms, 2 iterations"
            out.append(at_most(name, row["error_mm"], LARGEST_ERROR, "mm RMS"))
    return out
