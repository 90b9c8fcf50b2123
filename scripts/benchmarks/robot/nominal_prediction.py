"""Prediction of the nominal robot of `rollout_mpc` against the robot that walks, by component.

Closed loops of the scene `flat` walk, step aside and turn. At some of their ticks the rods, set back
to their true state, and the nominal robot, with the torso's true pose, the legs it has followed so
far and the friction of the floor, execute the same plan, and the plan changed along each direction
in which the policy changes it. The error is the RMS over the states of the difference of their
poses at the end of the plan, in the heading frame. The sensitivity is the change of the poses over
all stages per change of the plan; of its error over its size, and of the correlation, the median
over the states.
"""

import dataclasses
from collections.abc import Iterator
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from benchmarks.harness import Check, Progress, at_least, at_most
from benchmarks.locomotion.cases import DT, friction, reachable
from slot_core.arrays import Array
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.geometry import rotate, rpy_of, wrapped
from slot_core.robot import read_robot
from slot_core.rollout_mpc.nominal_robot import NominalRobot
from slot_core.rollout_mpc.problem import PlanProblem
from slot_core.rollout_mpc.settings import read_rollout_mpc
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.rod_robot import RodRobot

FORWARD, ASIDE, TURN = (0.05, 0.0, 0.0), (0.0, 0.04, 0.0), (0.0, 0.0, 0.15)
LOOPS = (
    (FORWARD, 0.4),
    (FORWARD, 0.2),
    (FORWARD, 0.6),
    (ASIDE, 0.4),
    (TURN, 0.4),
)
FIRST, EVERY, LAST = 90, 25, 200  # ticks; a stride has 21.2
COMPONENTS = ("roll", "pitch", "yaw", "x", "y", "z")
SCALES = np.array([180 / np.pi] * 3 + [1e3] * 3)
UNITS = ("deg", "deg", "deg", "mm", "mm", "mm")
ERROR_MAX, CORRELATION_MIN = 3.0, 0.8  # mm and 1, of x in walks


class Seen(NamedTuple):
    """A tick of a closed loop."""

    buffer: Array  # state of the rods
    state: Array  # (12,) true state of the torso
    start: Any  # state of the nominal robot, with its legs
    wrench: Array  # (3,) that the policy has learned
    plan: Array  # (K + 1, 4) rad


def rows(quick: bool, progress: Progress) -> list[dict[str, Any]]:
    """Rows of each component: all walks, and the turn in place."""
    found: dict[bool, list[tuple[Array, Array]]] = {False: [], True: []}
    for velocity, mu in LOOPS[: 1 if quick else None]:
        progress(f"prediction: {velocity}, friction {mu}")
        found[velocity == TURN] += compared(velocity, mu)
    return [
        row
        for turns, pairs in found.items()
        if pairs
        for row in components("turn in place" if turns else "walk", pairs)
    ]


def components(motion: str, pairs: list[tuple[Array, Array]]) -> Iterator[Any]:
    """The row of each component from poses (P, K, 6) of rods and model at the states."""
    true, model = (np.array(poses) for poses in zip(*pairs))  # (S, P, K, 6)
    error = SCALES * (model - true)[:, 0, -1]
    changed = [poses[:, 1:] - poses[:, :1] for poses in (true, model)]
    size, other = (np.sqrt(np.square(c).sum(axis=(1, 2))) for c in changed)
    missed = np.sqrt(np.square(changed[1] - changed[0]).sum(axis=(1, 2)))
    alike = (changed[0] * changed[1]).sum(axis=(1, 2)) / (size * other)
    for k, name in enumerate(COMPONENTS):
        yield {
            "kind": "prediction",
            "motion": motion,
            "component": name,
            "states": len(true),
            "error": float(np.sqrt(np.square(error[:, k]).mean())),
            "unit": UNITS[k],
            "sensitivity_error": float(np.median((missed / size)[:, k])),
            "correlation": float(np.median(alike[:, k])),
        }


def compared(
    velocity: tuple[float, float, float], mu: float
) -> Iterator[tuple[Array, Array]]:
    """Poses (P, K, 6) of the rods and of the nominal robot from each state of a closed loop."""
    settings, robot = read_rollout_mpc(), read_robot()
    problem = PlanProblem(settings, robot.tendon.angle_max, DT)
    nominal = dataclasses.replace(settings.nominal, friction=mu)
    model = NominalRobot(robot, nominal, DT)
    loop, seen = watched(velocity, mu)
    for tick in seen:
        plans, _ = problem.varied(tick.plan)
        plans = np.clip(plans, 0.0, robot.tendon.angle_max)
        model.set_wrench(tick.wrench, tick.state[2])
        poses = (
            np.array(
                [
                    executed(loop, tick.buffer, plan, nominal.cycles)
                    for plan in plans
                ]
            ),
            model.roll_out(model.measured(tick.start, tick.state), plans).pose,
        )
        yield tuple(in_heading(pose, tick.state) for pose in poses)


def watched(
    velocity: tuple[float, float, float], mu: float
) -> tuple[RodRobot, list[Seen]]:
    """The rods of a closed loop, and what was seen at some of its ticks."""
    loop = ClosedLoop(
        "flat",
        "walk",
        reachable("walk", velocity),
        1,
        DEFAULT_POLICY,
        changes=dict(friction(mu)),
    )
    sim, policy, seen = loop.plant.robot, loop.controller.policy, []
    for k, tick in enumerate(loop.run(LAST)):
        plan = policy._plan
        if k < FIRST or (k - FIRST) % EVERY or plan is None:
            continue
        turned = sim.rotation @ sim.angular_velocity
        torso = [rpy_of(sim.rotation), sim.position, turned, sim.velocity]
        seen.append(
            Seen(
                sim.state.buffer.copy(),
                np.concatenate(torso),
                plan.start,
                policy.observer.wrench.copy(),
                np.vstack([tick.plan.angle, tick.plan.angle[-1:]]),
            )
        )
    return sim, seen


def executed(sim: RodRobot, buffer: Array, plan: Array, cycles: int) -> Array:
    """Poses (K, 6) of the rods over a plan (K + 1, 4) from a state, in cycles of the servo bus."""
    sim.state.buffer[:], poses = buffer, []
    steps = round(DT / cycles / sim.scene.solver.step)
    for here, there in pairwise(plan):
        for cycle in range(cycles):
            sim.advance(steps, here + cycle / cycles * (there - here))
        poses.append(np.concatenate([sim.rpy, sim.position]))
    return np.array(poses)


def in_heading(pose: Array, state: Array) -> Array:
    """Poses (P, K, 6) less the place and heading of a state, in its heading frame."""
    moved = pose.copy()
    moved[..., 2] = wrapped(pose[..., 2] - state[2])
    moved[..., 3:5] = rotate(pose[..., 3:5] - state[3:5], -state[2])
    return moved


def checks(found: list[dict[str, Any]]) -> list[Check]:
    """The figures of x in walks against the goals."""
    return [
        check
        for row in found
        if (row["motion"], row["component"]) == ("walk", "x")
        for check in (
            at_most("prediction of x", row["error"], ERROR_MAX, "mm RMS"),
            at_least(
                "correlation of its sensitivity",
                row["correlation"],
                CORRELATION_MIN,
            ),
        )
    ]
