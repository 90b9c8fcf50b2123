"""The walk over the bus beside the simulator's own servos, and beside what parts equal walks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from benchmarks.harness import Check, Row, at_most
from benchmarks.servo.twins import TWINS, apart, walk
from slot_core.report.palette import INK, SECONDARY, TRUE
from slot_core.simulation.plant import Plant

TICK = 0.033  # s
DURATION = 10.0  # s
RMS_GOAL = 2.0  # mm
SPEED_GOAL = 1.0  # mm/s
NUDGE = 1e-9  # m/s
STYLES = {
    "sim": (SECONDARY, "-", "servo.yaml"),
    "law": (TRUE, "-", "servos' law, no bus"),
    "bus": (INK, ":", "driver, bus and servos"),
}


def walks() -> dict[str, npt.NDArray[np.float64]]:
    """Ways of the torso (n, 3), m, by name; those behind a plus sign differ from `sim` in it."""
    ticks = round(DURATION / TICK)
    ways = {name: walk(make, ticks) for name, make in TWINS.items()}
    ways["sim + start 1 nm/s faster"] = walk(_nudged, ticks)
    ways["sim + another seed"] = walk(Plant, ticks, seed=1)
    return ways


def rows(ways: dict[str, npt.NDArray[np.float64]]) -> Iterator[Row]:
    """Speed of every walk and its distance from the two that it is to be compared with."""
    for name, way in ways.items():
        yield {
            "kind": "twin",
            "walk": name,
            "v_x_mm_s": 1e3 * speed(way),
            "rms_from_bus_mm": 1e3 * apart(way, ways["bus"]),
            "rms_from_sim_mm": 1e3 * apart(way, ways["sim"]),
        }


def checks(found: list[Row]) -> list[Check]:
    """The agreement that is promised."""
    by_name = {row["walk"]: row for row in found}
    slower = abs(by_name["bus"]["v_x_mm_s"] - by_name["sim"]["v_x_mm_s"])
    apart_mm = by_name["law"]["rms_from_bus_mm"]
    return [
        at_most("walk with the bus from that without it, RMS", apart_mm, RMS_GOAL, "mm"),
        at_most("speed with the bus from that of servo.yaml", slower, SPEED_GOAL, "mm/s"),
    ]


def speed(way: npt.NDArray[np.float64]) -> float:
    """Along x, m/s, after the first 3 s."""
    late = way[round(3.0 / TICK) :, 0]
    return float((late[-1] - late[0]) / (TICK * (len(late) - 1)))


def draw(ways: dict[str, npt.NDArray[np.float64]], path: Path) -> None:
    """Height in the last seconds, and how far the walks part."""
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    height, distance = figure.subplots(2, 1)
    times = TICK * np.arange(len(ways["bus"]))
    for name, (colour, style, label) in STYLES.items():
        height.plot(times, 1e3 * ways[name][:, 2], style, color=colour, label=label)
        parted = 1e3 * np.linalg.norm(ways[name] - ways["bus"], axis=1)
        distance.plot(times, parted, style, color=colour)
    height.set(ylabel="height of the torso, mm", xlim=(DURATION - 3.0, DURATION))
    distance.set(xlabel="time, s", ylabel="distance from the bus, mm", xlim=(0.0, DURATION))
    height.legend(frameon=False, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    for axes in (height, distance):
        axes.grid(alpha=0.3)
    figure.savefig(path, dpi=150)


def _nudged(*arguments: Any) -> Plant:
    plant = Plant(*arguments)
    plant.simulator.state.velocity[0] += NUDGE
    return plant
