"""Rows that compare the robot on spatial rod legs with the same robot in MuJoCo.

- sideways: a leg with a pulled tendon, no floor, no weight; its tip is pulled sideways. Deflection
  per force in both engines.
- loaded: the same with a quarter of the robot's weight on the tip, as a floor presses it upward.
- stand: height of the torso under the scene's tendon angle.
- replay: the gaits' tendon angles at amplitude one, without feedback, on floors of several
  frictions. Mean speeds over the strides that count in config/tune.yaml.
"""

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from benchmarks.harness import Check, Progress, at_most
from benchmarks.robot.mujoco_robot import STEP, MujocoRobot
from slot_core import config
from slot_core.arrays import Array
from slot_core.drawing import palette
from slot_core.dynamics.scene import Scene, read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.gait.gait import Stride, read_gaits
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY, RobotParameters, read_robot
from slot_core.simulation.rod_robot import RodRobot
from slot_lab.tuning.stride_run import TuningSettings, read_tuning, stride_means

GAITS = ("walk", "fast_walk", "crawl")
ANGLES_DEG = (40.0, 63.0, 90.0)  # tendon angles of the stiffness
SETTLED = 3.0  # s: vibrations of a leg under a load have died away
TIP_MASS = 0.02  # kg
SIDEWAYS = 1.0  # m/s^2
HELD = 1e9  # kg, a torso that no leg moves
# s, at which also a loaded leg comes to rest in `SETTLED`
RESTING_DAMPING = 0.05
FEW_NODES = 14  # of a leg in MuJoCo with `quick`
QUICK = ("walk", 0.2)
# The crawl, whose feet slide most of the time, changes by a third between 0.2 and 0.1 ms.
FINER = {"crawl": 1e-4}  # s
SHARE, SPEED = 0.1, 3.0  # goal of a replay: a share of our speed, or mm/s
STIFFNESS_PERCENT, STAND_MM = 5.0, 1.0
ENGINES = {  # name, colour, mark, place beside the other engine's
    "own": ("rod legs of this project", palette.TRUE, "o", -0.08),
    "other": ("hinge chains in MuJoCo", palette.SECONDARY, "s", 0.08),
}


def rows(quick: bool, out: Path, progress: Progress) -> list[dict[str, Any]]:
    """All rows; the plot of the replays goes to `out/other_engine.png`."""
    robot, scene = read_robot(), read_scene("flat")
    still = config.replace(scene, {"solver.nodes": FEW_NODES} if quick else {})
    progress("other engine: stiffness and stand")
    found = []
    for degrees in ANGLES_DEG[1:2] if quick else ANGLES_DEG:
        found += [
            sideways_row(robot, still, degrees),
            loaded_row(robot, still, degrees),
        ]
    found.append(stand_row(robot, still))
    replays = list(replay_rows(robot, scene, quick, progress))
    draw_engines(replays, out / "other_engine.png")
    return [*found, *replays]


def hold(sim: SimulatedRobot, degrees: float) -> None:
    """Hold commanded tendon angles (deg) for `SETTLED`, in pieces of 10 ms."""
    for _ in range(round(SETTLED / 0.01)):
        sim.advance(
            round(0.01 / sim.scene.solver.step),
            np.full(4, math.radians(degrees)),
        )


def sideways_row(
    robot: RobotParameters, scene: Scene, degrees: float
) -> dict[str, Any]:
    """Sideways deflection of a free leg's tip per force, mm/N."""
    field, force = SIDEWAYS * aside(robot), TIP_MASS * SIDEWAYS
    bare, loaded = (
        own_leg(robot, scene, degrees, field, mass) for mass in (0.0, TIP_MASS)
    )
    other = other_leg(robot, scene, degrees, np.zeros(3), force * aside(robot))
    return {
        "kind": "sideways",
        "tendon_deg": degrees,
        "nodes": len(bare),
        "own_mm_per_N": 1e3
        * float((loaded[-1] - bare[-1]) @ aside(robot))
        / force,
        "other_mm_per_N": 1e3 * float(other[-1] @ aside(robot)) / force,
    }


def loaded_row(
    robot: RobotParameters, scene: Scene, degrees: float
) -> dict[str, Any]:
    """The same per sideways force on a tip with a quarter of the robot's weight; mm/N.

    A field acts upward and sideways on a mass at the tip, and on the leg itself.
    """
    mass = robot.mass / 4
    field = np.array([0.0, 0.0, GRAVITY]) + SIDEWAYS * aside(robot)
    own = own_leg(robot, scene, degrees, field, mass)
    other = other_leg(robot, scene, degrees, field, mass * field)
    row: dict[str, Any] = {
        "kind": "loaded",
        "tendon_deg": degrees,
        "nodes": len(own),
    }
    for name, tip in (("own", own[-1]), ("other", other[-1])):
        yielded = float(tip @ aside(robot)) / (mass * SIDEWAYS)
        row[f"{name}_mm_per_N"] = 1e3 * yielded
        row[f"{name}_drop_mm"] = -1e3 * float(tip[2])
    return row


def aside(robot: RobotParameters) -> Array:
    """(3,) unit vector sideways of leg FL."""
    x, y, _ = robot.outward[0]
    return np.array([-y, x, 0.0])


def own_leg(
    robot: RobotParameters,
    scene: Scene,
    degrees: float,
    field: Array,
    mass: float,
) -> Array:
    """Nodes (N, 3) of leg FL from its clamp, m, in a field (m/s^2), with a mass (kg) at the tip."""
    sim = held(RodRobot, robot, scene, field)
    sim.model.rod.mass[-1] += mass
    hold(sim, degrees)
    return sim.nodes[0] - sim.nodes[0, 0]


def other_leg(
    robot: RobotParameters,
    scene: Scene,
    degrees: float,
    field: Array,
    tip: Array,
) -> Array:
    """The same in MuJoCo, with a force (3,), N, at the tip."""
    sim = held(MujocoRobot, robot, scene, field)
    sim.pull_tip(0, tip)
    hold(sim, degrees)
    return sim.nodes[0] - sim.nodes[0, 0]


def held(kind: Any, robot: RobotParameters, scene: Scene, field: Array) -> Any:
    """The robot above its floor in a field (m/s^2), with legs that come to rest soon.

    No leg moves the torso, which a push holds against its weight.
    """
    still = dataclasses.replace(
        robot,
        torso=dataclasses.replace(robot.torso, mass=HELD),
        leg=dataclasses.replace(robot.leg, damping_time=RESTING_DAMPING),
    )
    changes = {
        "gravity": field.tolist(),
        "start.height": 5.0,
        "start.settle": 0.0,
    }
    sim = kind(still, config.replace(scene, changes), read_servo())
    sim.push(-HELD * field, np.zeros(3))
    return sim


def stand_row(robot: RobotParameters, scene: Scene) -> dict[str, Any]:
    """Height of the torso that stands under the scene's tendon angle, mm."""
    degrees = scene.start.tendon_angle_deg
    row = {
        "kind": "other stand",
        "nodes": scene.solver.nodes,
        "tendon_deg": degrees,
    }
    for name, kind in (("own", RodRobot), ("other", MujocoRobot)):
        sim = kind(robot, scene, read_servo())
        hold(sim, degrees)
        row[f"{name}_mm"] = 1e3 * float(sim.position[2])
    return row


def replay_rows(
    robot: RobotParameters, scene: Scene, quick: bool, progress: Progress
) -> Iterator[dict[str, Any]]:
    """Replays of the gaits on the floors of config/tune.yaml; `quick`: of one on one floor.

    The goal bounds the difference of the speeds, mm/s.
    """
    tuning, strides, other = read_tuning(), read_gaits().strides, {}
    cases = [(gait, friction) for gait in GAITS for friction in tuning.friction]
    if quick:
        cases, tuning = [QUICK], dataclasses.replace(tuning, strides=4)
        other = {"solver.nodes": FEW_NODES}
    for gait, friction in cases:
        progress(f"other engine: {gait} at friction {friction}")
        floor = config.replace(scene, {"floor.friction": [friction] * 4})
        place, step = config.replace(floor, other), FINER.get(gait, STEP)
        row: dict[str, Any] = {
            "kind": "replay",
            "gait": gait,
            "friction": friction,
        }
        makers = {
            "own": partial(RodRobot, robot, floor, read_servo()),
            "other": partial(MujocoRobot, robot, place, read_servo(), step),
        }
        for name, make in makers.items():
            row[f"{name}_v_x"] = replay(make, strides[gait], tuning)
        row["difference"] = abs(row["own_v_x"] - row["other_v_x"])
        row["goal"] = max(SHARE * abs(row["own_v_x"]), SPEED)
        yield row


def replay(
    make: Callable[[], SimulatedRobot], stride: Stride, tuning: TuningSettings
) -> float:
    """Mean speed over the strides that count, mm/s, at amplitude one and without offsets.

    NaN if the simulation diverges.
    """
    try:
        return 1e3 * float(stride_means(tracked(make(), stride, tuning))[0])
    except DivergenceError:
        return math.nan


def tracked(
    sim: SimulatedRobot, stride: Stride, tuning: TuningSettings
) -> Array:
    """(n, 7) time, position, roll, pitch and yaw after each command of the strides that count."""
    dt, settling = tuning.command_period, tuning.settling_strides
    steps, first = (
        round(dt / sim.scene.solver.step),
        round(settling * stride.period / dt),
    )
    last = round((settling + tuning.strides) * stride.period / dt)
    velocity = np.array([stride.forward.speed, 0.0, 0.0])
    phase = np.arange(last) * dt / stride.period % 1.0
    angle = stride.stride_table(phase, velocity)[:, :4]
    rows = []
    for command in np.minimum(angle, sim.parameters.tendon.angle_max):
        sim.advance(steps, command)
        rows.append([sim.time, *sim.position, *sim.rpy])
    return np.array(rows[first - 1 :])


def checks(found: list[dict[str, Any]]) -> list[Check]:
    """The differences of the engines against their goals."""
    out = []
    for kind, leg in (("sideways", "a free"), ("loaded", "a loaded")):
        worst = max(
            100 * abs(row["other_mm_per_N"] / row["own_mm_per_N"] - 1)
            for row in found
            if row["kind"] == kind
        )
        name = f"MuJoCo: sideways compliance of {leg} leg"
        out.append(at_most(name, worst, STIFFNESS_PERCENT, "%"))
    [stand] = (row for row in found if row["kind"] == "other stand")
    apart = abs(stand["own_mm"] - stand["other_mm"])
    return [
        *out,
        at_most("MuJoCo: height of the standing robot", apart, STAND_MM, "mm"),
        *(
            at_most(
                f"MuJoCo: speed of {row['gait']} at friction {row['friction']}",
                row["difference"],
                row["goal"],
                "mm/s",
            )
            for row in found
            if row["kind"] == "replay"
        ),
    ]


def draw_engines(rows: Sequence[Mapping[str, Any]], path: Path) -> None:
    """Write the plot of the replays: a panel for each gait, a pair of points for each floor.

    The shade is the goal around our speed.
    """
    gaits = list(dict.fromkeys(row["gait"] for row in rows))
    figure = Figure(figsize=(1.2 + 3.0 * len(gaits), 4.2), layout="constrained")
    panels = figure.subplots(1, len(gaits), sharey=True, squeeze=False)[0]
    for ax, gait in zip(panels, gaits):
        floors = [row for row in rows if row["gait"] == gait]
        for k, row in enumerate(floors):
            ax.bar(
                k,
                2 * row["goal"],
                0.5,
                row["own_v_x"] - row["goal"],
                color=palette.SHADE,
                ec=palette.PALE,
                label="goal: within 10 % or 3 mm/s" if k == 0 else None,
            )
        for name, (label, colour, mark, beside) in ENGINES.items():
            places = [k + beside for k in range(len(floors))]
            ax.plot(
                places,
                [row[f"{name}_v_x"] for row in floors],
                mark,
                color=colour,
                label=label,
            )
        ax.set_xticks(
            range(len(floors)), [f"{row['friction']:g}" for row in floors]
        )
        ax.set(
            title=gait,
            xlabel="friction of the floor",
            xlim=(-0.6, len(floors) - 0.4),
        )
        ax.grid(axis="y", color=palette.PALE, lw=0.5)
    panels[0].set_ylim(bottom=min(0.0, panels[0].get_ylim()[0]))
    panels[0].set_ylabel("mean speed, mm/s")
    figure.legend(
        *panels[0].get_legend_handles_labels(),
        loc="outside lower center",
        ncols=3,
    )
    figure.savefig(path, dpi=150)
