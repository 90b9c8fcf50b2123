"""Margins of the default walk: what friction, guides and weak servos leave of it."""

import itertools
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Check, at_most
from benchmarks.locomotion.cases import (
    DEFAULT,
    Case,
    Changes,
    Job,
    WalkMotion,
    friction,
    guides,
    weak_servos,
)
from benchmarks.locomotion.rows import DEG, MM, SPEED, WARM_UP
from slot_core.drawing import palette
from slot_core.dynamics.servo import read_servo

FRICTION = (0.1, 0.2, 0.4, 0.6, 0.8, 1.0, 1.2)
USUAL = (0.2, 0.4, 0.6)  # also with an almost empty battery
VOLTAGE = (11.1, 9.6)  # V, of a battery's nominal and almost empty cells
WITH: Mapping[str, Changes] = {
    "": (),
    "guides .15": guides(0.15),
    "guides .3": guides(0.3),
    "stall -10 %": weak_servos(0.9),
    "stall -20 %": weak_servos(0.8),
}
"""Changes by name, each on a floor of friction .4 at the nominal voltage."""
SEED = 1
LARGEST_LOAD = 50.0  # % of the stall torque, at the nominal voltage
SHOWN = {
    "speed": "m/s",
    "aside": "mm per m walked",
    "heading": "deg",
    "tilt": "deg RMS",
    "load": "% of stall",
}


def jobs(quick: bool) -> list[Job]:
    """A walk at the usual speed on every floor, at both voltages, and with every change."""
    duration = WARM_UP + (7.0 if quick else 28.0)
    pairs = [(mu, VOLTAGE[0]) for mu in (USUAL if quick else FRICTION)]
    if not quick:
        pairs += itertools.product(USUAL, VOLTAGE[1:])
    floors = {
        (mu, volt): (*friction(mu), ("scene.supply_voltage", volt))
        for mu, volt in pairs
    }
    changed = [] if quick else WITH.values()
    usual = floors[0.4, VOLTAGE[0]]
    walks = [
        Case(duration, velocity=(SPEED, 0.0, 0.0), changes=floor)
        for floor in [*floors.values(), *((*usual, *one) for one in changed)]
    ]
    return [(walk, DEFAULT, SEED) for walk in dict.fromkeys(walks)]


def row(case: Case, whole: WalkMotion) -> dict[str, Any]:
    """Speed, straightness, tilt and load of the servos after the start of a walk.

    aside: largest stride mean of |y| over the distance; load: mean torque over the stall torque at
    the voltage.
    """
    set_to, motion = dict(case.changes), whole.after(WARM_UP)
    mu, volt = set_to["scene.floor.friction"][0], set_to["scene.supply_voltage"]
    y = motion.moving_mean(motion.position[:, 1] - motion.position[0, 1])
    stall = float(read_servo().tendon_stall(volt))
    return {
        "kind": "margin",
        "friction": mu,
        "voltage": volt,
        "with": {changes: name for name, changes in WITH.items()}[
            case.changes[2:]
        ],
        "fallen": motion.fallen,
        "speed": motion.forward_speed,
        "aside": MM
        * float(np.abs(y).max())
        / float(np.ptp(motion.position[:, 0])),
        "heading": DEG * motion.heading,
        "tilt": DEG * math.sqrt(np.mean(motion.tilt**2)),
        "load": 100.0 * float(motion.torque.mean()) / stall,
    }


def checks(found: Sequence[dict[str, Any]]) -> list[Check]:
    """The servos' load at the nominal voltage against its goal."""
    loads = [
        values["load"]
        for values in found
        if values["voltage"] == VOLTAGE[0]
        and values["friction"] in USUAL
        and not values["with"]
    ]
    return [
        at_most(
            f"load of the servos, walk at {SPEED:g}, mu .2 to .6",
            max(loads),
            LARGEST_LOAD,
            "% of stall",
        )
    ]


def draw(found: Sequence[dict[str, Any]], path: Path) -> None:
    """The margins over friction, a line for each voltage, a cross for each change."""
    figure = Figure(figsize=(8.0, 4.6), layout="constrained")
    *plots, rest = figure.subplots(2, 3).flat
    for ax, (name, unit) in zip(plots, SHOWN.items()):
        for volt, colour in zip(VOLTAGE, (palette.TRUE, palette.SECONDARY)):
            line = [
                values
                for values in found
                if values["voltage"] == volt and not values["with"]
            ]
            ax.plot(
                [values["friction"] for values in line],
                [values[name] for values in line],
                "o-",
                color=colour,
                label=f"{volt:g} V",
            )
        for values in found:
            if label := values["with"]:
                ax.plot(values["friction"], values[name], "x", label=label)
        ax.set_title(f"{name}, {unit}", fontsize=10, loc="left")
        ax.set(xlabel="friction", xticks=FRICTION[1:])
        ax.set_ylim(bottom=0.0)
        ax.grid(color=palette.PALE, lw=0.4)
    rest.set_axis_off()
    rest.legend(
        *plots[0].get_legend_handles_labels(),
        loc="center",
        title="voltage, or with",
        frameon=False,
    )
    figure.savefig(path, dpi=150)
