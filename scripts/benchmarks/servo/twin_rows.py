"""The walk over the servo bus against the simulator's servos and against small perturbations."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from benchmarks.harness import Check, Row, at_most
from benchmarks.servo.twins import PLANTS, rms_distance, walk
from slot_core.dynamics.scene import read_scene
from slot_core.report.palette import INK, SECONDARY, TRUE
from slot_core.simulation.plant import Plant

TICK = read_scene("flat").sensors.odometry.period  # s
DURATION = 10.0  # s
RMS_GOAL = 1.0  # mm
SPEED_GOAL = 1.0  # mm/s
SPEED_CHANGE = 1e-9  # m/s, of the start in `sim + start 1 nm/s faster`
STYLES = {
    "sim": (SECONDARY, "-", "servo.yaml"),
    "line": (TRUE, "-", "torque-speed line"),
    "bus": (INK, ":", "driver, bus and servos"),
}


def walks() -> dict[str, npt.NDArray[np.float64]]:
    """Paths of the torso (n, 3), m, by name; after a plus sign the difference from `sim`."""
    ticks = round(DURATION / TICK)
    paths = {name: walk(make, ticks) for name, make in PLANTS.items()}
    paths["sim + start 1 nm/s faster"] = walk(_faster_start, ticks)
    paths["sim + another seed"] = walk(Plant, ticks, seed=1)
    return paths


def rows(paths: dict[str, npt.NDArray[np.float64]]) -> Iterator[Row]:
    """Speed of every walk, and its RMS distance from the walks `bus` and `sim`."""
    for name, way in paths.items():
        yield {
            "kind": "twin",
            "walk": name,
            "v_x_mm_s": 1e3 * speed(way),
            "rms_from_bus_mm": 1e3 * rms_distance(way, paths["bus"]),
            "rms_from_sim_mm": 1e3 * rms_distance(way, paths["sim"]),
        }


def checks(found: list[Row]) -> list[Check]:
    """Distance and difference in speed against their goals."""
    by_name = {row["walk"]: row for row in found}
    difference = abs(by_name["bus"]["v_x_mm_s"] - by_name["sim"]["v_x_mm_s"])
    apart_mm = by_name["sim"]["rms_from_bus_mm"]
    return [
        at_most("RMS distance of the walks with and without bus", apart_mm, RMS_GOAL, "mm"),
        at_most("difference in speed, bus and servo.yaml", difference, SPEED_GOAL, "mm/s"),
    ]


def speed(path: npt.NDArray[np.float64]) -> float:
    """Mean speed of a path (n, 3) along x after the first 3 s, m/s."""
    late = path[round(3.0 / TICK) :, 0]
    return float((late[-1] - late[0]) / (TICK * (len(late) - 1)))


def draw(paths: dict[str, npt.NDArray[np.float64]], path: Path) -> None:
    """Write the picture: height in the last 3 s, and distance of each walk from `bus`."""
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    height, distance = figure.subplots(2, 1)
    times = TICK * np.arange(len(paths["bus"]))
    for name, (colour, style, label) in STYLES.items():
        height.plot(times, 1e3 * paths[name][:, 2], style, color=colour, label=label)
        apart_mm = 1e3 * np.linalg.norm(paths[name] - paths["bus"], axis=1)
        distance.plot(times, apart_mm, style, color=colour)
    height.set(ylabel="height of the torso, mm", xlim=(DURATION - 3.0, DURATION))
    distance.set(xlabel="time, s", ylabel="distance from the bus, mm", xlim=(0.0, DURATION))
    height.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for axes in (height, distance):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=150)


def _faster_start(*arguments: Any) -> Plant:
    plant = Plant(*arguments)
    plant.simulator.state.velocity[0] += SPEED_CHANGE
    return plant
