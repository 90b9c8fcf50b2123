"""Rows that compare the robot on spatial rod legs with the same robot in MuJoCo.

- sideways: a leg with a pulled tendon, no floor, no weight; its tip is pulled sideways. Deflection
  per force in both engines, and by the unit-load integral along the bent leg.
- loaded: the same with a quarter of the robot's weight on the tip, as a floor presses it upward.
- stand: height of the torso under the scene's tendon angle.
- replay: the gaits' tendon angles at amplitude one, without feedback, on floors of several
  frictions. Mean velocities over the strides that count in config/tune.yaml.
- variation: one replay again with one setting changed, of either engine.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from benchmarks.harness import Check, Progress, at_most
from benchmarks.robot.mujoco_robot import DEFAULT, Engine, MujocoRobot
from benchmarks.robot.plots import draw_engines
from slot_core import config
from slot_core.arrays import Array
from slot_core.dynamics.rod import discretise, sections
from slot_core.dynamics.scene import Scene, read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.gait.gait import Stride, read_gaits
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY, Leg, RobotParameters, read_robot
from slot_core.simulation.rod_robot import RodRobot
from slot_lab.tuning.settings import TuningSettings, read_tuning
from slot_lab.tuning.stride_run import stride_means

Make = Callable[[Scene], SimulatedRobot]

GAITS = ("walk", "fast_walk", "crawl")
ANGLES_DEG = (40.0, 63.0, 90.0)  # tendon angles of the stiffness
SETTLED = 3.0  # s: vibrations of a leg under a load have died away
TIP_MASS = 0.02  # kg
SIDEWAYS = 1.0  # m/s^2
HELD = 1e9  # kg, a torso that no leg moves
RESTING_DAMPING = (
    0.05  # s, damping time at which also a loaded leg comes to rest in `SETTLED`
)
FEW_NODES = 14  # of a leg in MuJoCo: the variations, and what `quick` runs
QUICK = ("walk", 0.2)
# The crawl, whose feet slide most of the time, changes by a third between 0.2 and 0.1 ms.
FINER = {"crawl": dataclasses.replace(DEFAULT, step=1e-4)}
VARIED = ("crawl", 0.2)
SHARE, SPEED = 0.1, 3.0  # goal of a replay: a share of our speed, or mm/s
STIFFNESS_PERCENT, STAND_MM = 5.0, 1.0
REASON = "what this speed depends on, in either engine: see the rows of kind variation"

# One setting changed at a time: name, of which engine, its changes, what it shows.
VARIATIONS: tuple[tuple[str, str, dict[str, Any]], ...] = (
    ("nothing", "own", {}),
    ("31 nodes", "own", {"solver.nodes": 31}),
    ("46 nodes", "own", {"solver.nodes": 46}),
    ("10 nodes", "own", {"solver.nodes": 10}),
    ("time step over four", "own", {"solver.step": 2.5e-4}),
    ("feet that stick without creep", "own", {"floor.friction_law": "bristle"}),
    ("creep of sticking feet times ten", "own", {"floor.friction_velocity": 1e-2}),
    ("damping of the contact times twelve", "own", {"floor.damping": 60.0}),
    (
        "contact twice as soft",
        "own",
        {"floor.stiffness": 1e4, "floor.line_stiffness": 1.1e6},
    ),
    ("nothing", "other", {}),
    ("half the time step", "other", {"step": 1e-4}),
    ("a quarter of the time step", "other", {"step": 5e-5}),
    ("contact half as soft", "other", {"hold": 0.975}),
    ("contact twice as soft", "other", {"hold": 0.9}),
    ("contact half as fast", "other", {"reach": 4e-3}),
    ("creep of sticking feet times ten", "other", {"tangential": 10.0}),
    ("creep of sticking feet over ten", "other", {"tangential": 1000.0}),
    ("links that do not stretch", "other", {"stretch": False}),
)


def rows(quick: bool, out: Path, progress: Progress) -> list[dict[str, Any]]:
    """All rows; the plot of the replays goes to `out/other_engine.png`."""
    robot = read_robot()
    scene = config.replace(read_scene("flat"), {"solver.legs": "spatial"})
    still = config.replace(scene, {"solver.nodes": FEW_NODES} if quick else {})
    progress("other engine: stiffness and stand")
    found = []
    for degrees in ANGLES_DEG[1:2] if quick else ANGLES_DEG:
        found += [
            sideways_row(robot, still, degrees),
            loaded_row(robot, still, degrees),
        ]
    found.append(stand_row(robot, still))
    found += replay_rows(robot, scene, quick, progress)
    if not quick:
        found += variation_rows(robot, scene, progress)
    draw_engines(
        [row for row in found if row["kind"] == "replay"], out / "other_engine.png"
    )
    return found


def own_robot(robot: RobotParameters) -> Make:
    """Maker of the project's robot in a scene."""
    return lambda scene: RodRobot(robot, scene, read_servo())


def other_robot(robot: RobotParameters, nodes: int, engine: Engine = DEFAULT) -> Make:
    """Maker of the robot in MuJoCo in a scene, with its own number of nodes."""

    def make(scene: Scene) -> SimulatedRobot:
        place = config.replace(scene, {"solver.nodes": nodes})
        return MujocoRobot(robot, place, read_servo(), engine)

    return make


def hold(sim: SimulatedRobot, degrees: float, seconds: float = SETTLED) -> None:
    """Hold commanded tendon angles (deg) for a time (s), in pieces of 10 ms."""
    for _ in range(round(seconds / 0.01)):
        sim.advance(
            round(0.01 / sim.scene.solver.step), np.full(4, math.radians(degrees))
        )


def sideways_row(
    robot: RobotParameters, scene: Scene, degrees: float
) -> dict[str, Any]:
    """Sideways deflection of a free leg's tip per force, mm/N."""
    field, tip = SIDEWAYS * aside(robot), TIP_MASS * SIDEWAYS * aside(robot)
    bare, loaded = (
        own_leg(robot, scene, degrees, field, mass) for mass in (0.0, TIP_MASS)
    )
    other = other_leg(robot, scene, degrees, np.zeros(3), tip)
    shape = bare @ np.column_stack([robot.outward[0], [0.0, 0.0, 1.0]])
    arc = discretise(robot.leg, len(bare), robot.tendon.end_fraction).arc
    compliance = {
        "own_mm_per_N": float((loaded[-1] - bare[-1]) @ aside(robot))
        / (TIP_MASS * SIDEWAYS),
        "other_mm_per_N": float(other[-1] @ aside(robot)) / (TIP_MASS * SIDEWAYS),
        "integral_mm_per_N": sideways_compliance(robot.leg, arc, shape),
    }
    row = {"kind": "sideways", "tendon_deg": degrees, "nodes": len(bare)}
    return row | {name: 1e3 * value for name, value in compliance.items()}


def loaded_row(robot: RobotParameters, scene: Scene, degrees: float) -> dict[str, Any]:
    """The same per sideways force on a tip with a quarter of the robot's weight; mm/N.

    A field acts upward and sideways on a mass at the tip, and on the leg itself.
    """
    mass = robot.mass / 4
    field = np.array([0.0, 0.0, GRAVITY]) + SIDEWAYS * aside(robot)
    own = own_leg(robot, scene, degrees, field, mass)
    other = other_leg(robot, scene, degrees, field, mass * field)
    row: dict[str, Any] = {"kind": "loaded", "tendon_deg": degrees, "nodes": len(own)}
    for name, nodes in (("own", own), ("other", other)):
        row[f"{name}_mm_per_N"] = (
            1e3 * float(nodes[-1] @ aside(robot)) / (mass * SIDEWAYS)
        )
        row[f"{name}_drop_mm"] = -1e3 * float(nodes[-1, 2])
    return row


def aside(robot: RobotParameters) -> Array:
    """(3,) unit vector sideways of leg FL."""
    x, y, _ = robot.outward[0]
    return np.array([-y, x, 0.0])


def held(robot: RobotParameters) -> RobotParameters:
    """The robot with a torso that no leg moves, and legs that come to rest soon."""
    torso = dataclasses.replace(robot.torso, mass=HELD)
    leg = dataclasses.replace(robot.leg, damping_time=RESTING_DAMPING)
    return dataclasses.replace(robot, torso=torso, leg=leg)


def own_leg(
    robot: RobotParameters, scene: Scene, degrees: float, field: Array, mass: float
) -> Array:
    """Nodes (N, 3) of leg FL from its clamp, m, in a field (m/s^2), with a mass (kg) at the tip.

    The torso is held by a push against its weight.
    """
    sim = RodRobot(held(robot), floating(scene, field.tolist()), read_servo())
    sim.model.rod.mass[-1] += mass
    sim.push(-HELD * field, np.zeros(3))
    hold(sim, degrees)
    return sim.nodes[0] - sim.nodes[0, 0]


def other_leg(
    robot: RobotParameters, scene: Scene, degrees: float, field: Array, tip: Array
) -> Array:
    """The same in MuJoCo, with a force (3,), N, at the tip."""
    sim = MujocoRobot(held(robot), floating(scene, field.tolist()), read_servo())
    sim.push(-HELD * field, np.zeros(3))
    sim.pull_tip(0, tip)
    hold(sim, degrees)
    return sim.nodes[0] - sim.nodes[0, 0]


def floating(scene: Scene, gravity: list[float]) -> Scene:
    """The scene above its floor, without settling, under a gravity (m/s^2)."""
    changes = {"gravity": gravity, "start.height": 5.0, "start.settle": 0.0}
    return config.replace(scene, changes)


def sideways_compliance(leg: Leg, arc: Array, nodes: Array) -> float:
    """Deflection of a bent leg's tip per force, both normal to its plane, m/N: unit-load integral.

    A unit force has at s the moment m = (r_L - r) x e_y: (m.b)^2 / E I_b + (m.t)^2 / G J, summed
    over the natural length with the tangent t and the normal b in the plane. arc: (N,) m, natural
    arc length; nodes: (N, 2) m, in the plane.
    """
    curve, s = CubicSpline(arc, nodes), np.linspace(0.0, arc[-1], 2001)
    arm, tangent = nodes[-1] - curve(s), curve(s, 1)
    tangent /= np.hypot(*tangent.T)[:, None]
    bending = arm[:, 0] * tangent[:, 0] + arm[:, 1] * tangent[:, 1]
    twist = arm[:, 0] * tangent[:, 1] - arm[:, 1] * tangent[:, 0]
    part = sections(leg, s / arc[-1])
    return float(np.trapezoid(bending**2 / part.lateral + twist**2 / part.torsion, s))


def stand_row(robot: RobotParameters, scene: Scene) -> dict[str, Any]:
    """Height of the torso that stands under the scene's tendon angle, mm."""
    degrees, height = scene.start.tendon_angle_deg, {}
    makers = {"own": own_robot(robot), "other": other_robot(robot, scene.solver.nodes)}
    for name, make in makers.items():
        sim = make(scene)
        hold(sim, degrees)
        height[f"{name}_mm"] = 1e3 * float(sim.position[2])
    return {
        "kind": "other stand",
        "tendon_deg": degrees,
        "nodes": scene.solver.nodes,
        **height,
    }


def replay_rows(
    robot: RobotParameters, scene: Scene, quick: bool, progress: Progress
) -> Iterator[dict[str, Any]]:
    """Replays of the gaits on the floors of config/tune.yaml; `quick`: of one on one floor."""
    tuning, strides = read_tuning(), read_gaits().strides
    cases = [(gait, friction) for gait in GAITS for friction in tuning.friction]
    nodes = scene.solver.nodes
    if quick:
        cases, tuning = [QUICK], dataclasses.replace(tuning, strides=4)
        nodes = FEW_NODES
    for gait, friction in cases:
        other = other_robot(robot, nodes, FINER.get(gait, DEFAULT))
        progress(f"other engine: {gait} at friction {friction}")
        floor = config.replace(scene, {"floor.friction": [friction] * 4})
        row: dict[str, Any] = {"kind": "replay", "gait": gait, "friction": friction}
        for name, make in (("own", own_robot(robot)), ("other", other)):
            found = replay(make, floor, strides[gait], tuning)
            row |= {f"{name}_{key}": value for key, value in found.items()}
        yield row | judged(row)


def replay(
    make: Make, scene: Scene, stride: Stride, tuning: TuningSettings
) -> dict[str, float]:
    """Mean motion over the strides that count, at amplitude one and without offsets.

    v_x, v_y in mm/s, yaw rate in rad/s, height in mm, tilt (RMS) in deg; NaN if the simulation
    diverges.
    """
    names = ("v_x", "v_y", "yaw_rate", "height", "tilt")
    try:
        track = tracked(make(scene), stride, tuning)
    except DivergenceError:
        return dict.fromkeys(names, math.nan)
    tilt = math.degrees(math.sqrt(np.square(track[:, 4:6]).sum(axis=1).mean()))
    means = np.array([1e3, 1e3, 1.0, 1e3]) * stride_means(track)[:4]
    return dict(zip(names, [*means.tolist(), tilt]))


def tracked(sim: SimulatedRobot, stride: Stride, tuning: TuningSettings) -> Array:
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


def judged(row: dict[str, Any]) -> dict[str, Any]:
    """Difference of the speeds and its goal, mm/s, and the reason if it is missed."""
    difference = abs(row["own_v_x"] - row["other_v_x"])
    goal = max(SHARE * abs(row["own_v_x"]), SPEED)
    reason = "" if difference <= goal else REASON
    return {"difference": difference, "goal": goal, "reason": reason}


def variation_rows(
    robot: RobotParameters, scene: Scene, progress: Progress
) -> Iterator[dict[str, Any]]:
    """One replay with one setting changed at a time; MuJoCo's with few nodes, for its time."""
    gait, friction = VARIED
    stride, tuning = read_gaits().strides[gait], read_tuning()
    floor = config.replace(scene, {"floor.friction": [friction] * 4})
    for name, which, change in VARIATIONS:
        progress(f"other engine: changed {name}")
        make, place, nodes = own_robot(robot), floor, FEW_NODES
        if which == "other":
            make = other_robot(robot, nodes, dataclasses.replace(DEFAULT, **change))
        else:
            place = config.replace(floor, change)
            nodes = place.solver.nodes
        row = {"kind": "variation", "engine": which, "changed": name, "nodes": nodes}
        found = replay(make, place, stride, tuning)
        yield row | {"gait": gait, "friction": friction} | found


def checks(found: list[dict[str, Any]]) -> list[Check]:
    """The differences of the engines against their goals."""
    out = []
    for kind, leg in (("sideways", "a free"), ("loaded", "a loaded")):
        pairs = [
            (r["other_mm_per_N"], r["own_mm_per_N"]) for r in found if r["kind"] == kind
        ]
        worst = max(
            (100 * abs(other / own - 1) for other, own in pairs), default=math.nan
        )
        name = f"MuJoCo: sideways compliance of {leg} leg"
        out.append(at_most(name, worst, STIFFNESS_PERCENT, "%"))
    for row in found:
        if row["kind"] == "other stand":
            apart = abs(row["own_mm"] - row["other_mm"])
            out.append(
                at_most("MuJoCo: height of the standing robot", apart, STAND_MM, "mm")
            )
        if row["kind"] == "replay":
            name = f"MuJoCo: speed of {row['gait']} at friction {row['friction']}"
            out.append(at_most(name, row["difference"], row["goal"], "mm/s"))
    return out
