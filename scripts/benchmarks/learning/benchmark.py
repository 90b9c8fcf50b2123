"""Environment for learners: its steps a second, and what the walk is like at each level.

The steps are those of the vector environment with the gait alone, resets not counted, by CPU time
on one core, then by wall time on all. The error of a level is that of the speed of the straight
walk from that of the level `fine`, on floors of friction 0.2 to 0.6. Beside them stand a snake of
gym-softrobot on PyElastica, one rod on a floor with friction, measured in the same run, and SoftQ
as published.
"""

import os
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gym_softrobot  # noqa: F401 - registers its environments
import gymnasium
import numpy as np

from benchmarks.harness import (
    Outcome,
    Progress,
    at_least,
    at_most,
    cpu_ratio,
    cpu_time,
)
from slot_core.simulation.many_robots import ANGLE
from slot_lab.learning.task import make_task
from slot_lab.learning.vector_env import CYCLES, WalkVectorEnv

REQUIRES = ("gymnasium", "gym_softrobot")
# level and time step (s) of the example, and of the goal
GOAL_CASE = ("standard", 0.0028)
CASES = (
    ("map", 0.0055),
    ("coarse", 0.0022),
    GOAL_CASE,
    ("coarse", 0.0),
    ("standard", 0.0),
)
REFERENCE = ("fine", 0.0)
ROBOTS, GOAL = 64, 5000.0  # steps a second, in GOAL_CASE
# of a step over the advance of its robots alone, in GOAL_CASE
STEP_RATIO = 1.12
# of steps a second: the first of CASES, whose legs are in lanes, over GOAL_CASE (one by one: 5.8)
MAP_RATIO = 9.0
FRICTION = (0.2, 0.4, 0.6)
# m/s; s, of walks: whole strides are measured
SPEED, WARM_UP, DURATION = (0.05, 4.0, 12.4)
SOFTQ = 30.0  # s of computing per simulated second, as published; not run here
# its octopuses need a COOMM that is not published
PEER, PEER_STEPS = ("ContinuumSnake-v0", 2)


def run(quick: bool, out: Path, progress: Progress) -> Outcome:
    """Measure throughput, levels and peers.

    The checks: steps a second in GOAL_CASE, and how much faster `map` is than it, and it than the
    peer.
    """
    rows, count = [], 10 if quick else 60
    for level, step in CASES[: 3 if quick else None]:
        progress(f"steps a second at level {level}")
        rows.append(throughput(level, step, 1, count))
    level, step = GOAL_CASE
    [learned] = (
        row for row in rows if (row["level"], row["step"]) == GOAL_CASE
    )
    rows.append(throughput(level, step, len(os.sched_getaffinity(0)), count))
    progress("speed of the walk at each level")
    rows += level_rows(quick)
    progress(f"gym-softrobot, {PEER}")
    peer = peer_row()
    return [
        *rows,
        peer,
        {
            "kind": "peer",
            "name": "SoftQ, as published",
            "speed": 1.0 / SOFTQ,
        },
    ], [
        at_least(
            f"steps of 33 ms on one core, {level} at {1e3 * step:g} ms",
            learned["steps_per_s"],
            GOAL,
            "1/s",
        ),
        at_most(
            f"step of the environment over its robots' alone, {level}",
            learned["over_robots"],
            STEP_RATIO,
        ),
        at_least(
            f"steps a second, {CASES[0][0]} over {level}",
            rows[0]["steps_per_s"] / learned["steps_per_s"],
            MAP_RATIO,
        ),
        at_least(
            f"simulated time over that of {peer['name']}",
            learned["speed"] / peer["speed"],
            1.0,
        ),
    ]


def throughput(
    level: str, step: float, threads: int, count: int
) -> dict[str, Any]:
    """Steps a second of the vector environment; `speed`: simulated seconds per second."""
    task = make_task(level=level, servos=False, duration=100.0)
    env = WalkVectorEnv(ROBOTS, task, threads=threads, step=step)
    env.reset(seed=1)
    still = np.zeros(env.action_space.shape)

    def walk() -> None:
        for _ in range(count):
            env.step(still)

    if threads == 1:
        took = cpu_time(walk, 3)
    else:
        begin = time.perf_counter()
        walk()
        took = time.perf_counter() - begin
    steps = ROBOTS * count / took
    angles = np.maximum(env._many.motion[:, None, ANGLE], 0.0)
    return {
        "kind": "throughput",
        "level": level,
        "step": step,
        "threads": threads,
        "steps_per_s": steps,
        "speed": steps * task.gaits.dt,
        "over_robots": cpu_ratio(
            lambda: env.step(still),
            lambda: env._many.advance(
                angles.repeat(CYCLES, axis=1), env._steps
            ),
            7,
        ),
    }


def level_rows(quick: bool) -> Iterator[dict[str, Any]]:
    """Speed of the gait alone at each level, and its error from the finest."""
    friction = FRICTION[1:2] if quick else FRICTION
    exact = walk_speeds(*(CASES[-1] if quick else REFERENCE), friction)
    for level, step in CASES:
        speeds = walk_speeds(level, step, friction)
        for mu, speed, reference in zip(friction, speeds, exact):
            yield {
                "kind": "level",
                "level": level,
                "step": step,
                "friction": mu,
                "mm_per_s": 1e3 * speed,
                "error": speed / reference - 1.0,
            }


def walk_speeds(
    level: str, step: float, friction: tuple[float, ...]
) -> list[float]:
    """Forward speed (m/s) of the gait alone on each floor, over whole strides."""
    speeds = []
    for mu in friction:
        task = make_task(
            level=level,
            servos=False,
            velocity=(SPEED, 0.0, 0.0),
            duration=100.0,
            drawn={"scene.floor.friction": (mu, mu)},
        )
        env, dt = WalkVectorEnv(1, task, step=step), task.gaits.dt
        env.reset(seed=1)
        first, place = round(WARM_UP / dt), []
        strides = int((DURATION - WARM_UP) / task.stride.period)
        for _ in range(first + round(strides * task.stride.period / dt)):
            env.step(np.zeros(env.action_space.shape))
            place.append(env.places[0])
        speeds.append(
            float(np.linalg.norm(place[-1] - place[first - 1]))
            / (dt * (len(place) - first))
        )
    return speeds


def peer_row() -> dict[str, Any]:
    """Simulated seconds per second of CPU of a snake of gym-softrobot."""
    env: Any = gymnasium.make(PEER).unwrapped
    env.reset(seed=1)
    env.action_space.seed(1)
    env.step(env.action_space.sample())  # compiles
    begin: float = env.time
    took = cpu_time(lambda: env.step(env.action_space.sample()), PEER_STEPS)
    return {
        "kind": "peer",
        "name": f"gym-softrobot {PEER}",
        "simulated_per_step": (env.time - begin) / (PEER_STEPS + 1),
        "speed": (env.time - begin) / (PEER_STEPS + 1) / took,
    }
