"""Rows of what happens at once: corners, steps, pushes, loads, slopes, ramps.

Errors of the place are those of stride means, since the torso sways.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np

from benchmarks.locomotion.cases import PERIOD, Case, WalkMotion, friction, push
from benchmarks.locomotion.rows import MM, SPEED, LocomotionRow, worst
from slot_core.robot import GRAVITY, Array

AT = 5.0  # s, of what happens at once
PLACE, TURN = 0.003, math.radians(1.0)  # of a robot that has recovered
EDGE = 0.3  # m, of the paths


def rows(quick: bool) -> list[LocomotionRow]:
    """All rows."""
    return [
        *_paths(quick),
        *_steps(quick),
        *_pushes(quick),
        *_loads(quick),
        *_postures(),
        *_steady(),
    ]


def _paths(quick: bool) -> list[LocomotionRow]:
    corner = ((0.0, 0.0), (EDGE, 0.0), (EDGE, EDGE))
    square = (*corner, (0.0, EDGE), (0.0, 0.0))
    found = []
    for name, path in (("corner", corner), ("square", square))[: 1 if quick else None]:
        duration = EDGE * (len(path) - 1) / SPEED + 3.5
        cases = [
            Case(duration, velocity=(SPEED, 0.0, 0.0), path=path, changes=friction(mu))
            for mu in ((0.4,) if quick else (0.2, 0.4, 0.6))
        ]
        found.append(LocomotionRow(f"{name} by path, RMS", "mm", 5.0, cases, worst(_off_path)))
    return found


def _off_path(case: Case, motion: WalkMotion) -> float:
    late = motion.after(3.0)
    distance = np.min([_distance(late.position[:, :2], *edge) for edge in _edges(case)], axis=0)
    return MM * float(np.sqrt(np.mean(distance**2)))


def _edges(case: Case) -> list[tuple[Array, Array]]:
    points = [np.array(point) for point in case.path]
    return list(itertools.pairwise(points))


def _distance(places: Array, begin: Array, end: Array) -> Array:
    """Distances (n,) of places (n, 2) from an edge, m."""
    along = end - begin
    share = np.clip((places - begin) @ along / (along @ along), 0.0, 1.0)
    return np.asarray(np.hypot(*(places - begin - share[:, None] * along).T))


def _steps(quick: bool) -> list[LocomotionRow]:
    def settled(case: Case, motion: WalkMotion) -> float:
        """Time until the mean velocity over a stride stays within a tenth of the step."""
        (_, before), (begin, after) = case.schedule
        moved = motion.moving_mean(motion.position[:, 0])
        count = len(motion.position) - len(moved)
        time = motion.time[count:]
        speed = np.gradient(moved, time)
        off = np.abs(speed - after[0]) > 0.1 * abs(after[0] - before[0])
        return float(time[off].max(initial=begin) - begin)

    def step(before: float, after: float) -> Case:
        schedule = ((0.0, (before, 0.0, 0.0)), (AT, (after, 0.0, 0.0)))
        return Case(AT + 4.0, schedule=schedule)

    up, back = [step(0.02, 0.06)], [step(0.06, -0.04)]
    found = [LocomotionRow("velocity .02 to .06: to a tenth", "s", 1.2, up, worst(settled))]
    if not quick:
        found += [LocomotionRow("velocity .06 to -.04: to a tenth", "s", 1.5, back, worst(settled))]
    return found


def _pushes(quick: bool) -> list[LocomotionRow]:
    begins = [AT + k * PERIOD / 4 for k in range(1 if quick else 4)]
    force = 0.83 / 0.2  # N for .2 s

    def pushed(begin: float, way: tuple[float, float, float]) -> Case:
        return Case(begin + 4.0, "push", velocity=(SPEED, 0.0, 0.0), changes=push(begin, way))

    aside = [pushed(begin, (0.0, force, 0.0)) for begin in begins]

    def errors(case: Case, motion: WalkMotion) -> tuple[Array, Array, Array]:
        """Times after the push, and how far the robot is aside and turned by then."""
        begin = dict(case.changes)["scene.pushes.left.time"]
        y, yaw = motion.moving_mean(motion.position[:, 1]), motion.moving_mean(motion.rpy[:, 2])
        time = motion.time[len(motion.time) - len(y) :] - begin
        start = int(np.searchsorted(time, 0.0))
        return time[start:], y[start:] - y[start], yaw[start:] - yaw[start]

    def peak(case: Case, motion: WalkMotion) -> float:
        return MM * float(np.abs(errors(case, motion)[1]).max())

    def recovery(case: Case, motion: WalkMotion) -> float:
        time, aside, turned = errors(case, motion)
        off = (np.abs(aside) > PLACE) | (np.abs(turned) > TURN)
        return float(time[off].max(initial=0.0))

    return [
        LocomotionRow("push of .83 N s aside: peak", "mm", 20.0, aside, worst(peak), 1.1),
        LocomotionRow("push of .83 N s aside: recovery", "s", 2.0, aside, worst(recovery), 1.0),
    ]


def _loads(quick: bool) -> list[LocomotionRow]:
    tilt, way = math.radians(4.0), math.radians(135.0)
    down = GRAVITY * math.sin(tilt)
    incline = (down * math.cos(way), down * math.sin(way), -GRAVITY * math.cos(tilt))
    events = {
        "payload .3 kg off centre": ((AT, "payload", (0.3, 0.03, 0.02, 0.03)),),
        "slope of 4 deg, diagonal": ((AT, "gravity", incline),),
        "friction .6 left, .2 right": ((AT, "friction", (0.6, 0.2, 0.6, 0.2)),),
        "friction .4 to .2": ((AT, "friction", (0.2, 0.2, 0.2, 0.2)),),
    }
    found = []
    for name, happens in list(events.items())[: 1 if quick else None]:
        cases = [Case(AT + 6.0, velocity=(SPEED, 0.0, 0.0), events=happens)]
        found.append(LocomotionRow(f"{name}, at once: place lost", "mm", 10.0, cases, worst(_lost)))
    return found


def _lost(case: Case, motion: WalkMotion) -> float:
    """Largest distance from the line that the robot would have walked on, mm."""
    x, y = (motion.moving_mean(column) for column in motion.position[:, :2].T)
    time = motion.time[len(motion.time) - len(x) :]
    start = int(np.searchsorted(time, AT))
    expected = x[start] + SPEED * (time[start:] - time[start])
    return MM * float(np.hypot(x[start:] - expected, y[start:] - y[start]).max())


def _postures() -> list[LocomotionRow]:
    ramp = Case(8.0, gait="stand", pose=(0.060, 0.0, 0.0), poses=((4.0, (0.030, 0.0, 0.0)),))

    def lag(case: Case, motion: WalkMotion) -> float:
        moving = motion.after(4.3, 5.4)  # from 60 to 30 mm at 20 mm/s
        wanted = 0.060 - 0.02 * (moving.time - 4.0)
        return MM * float(np.abs(moving.position[:, 2] - wanted).mean())

    def speed(case: Case, motion: WalkMotion) -> float:
        return math.degrees(motion.after(6.0).goal_speed.mean())

    still = [Case(10.0, gait="stand")]
    return [
        LocomotionRow("standing, ramp of 30 mm: lag", "mm", 2.0, [ramp], worst(lag), None),
        LocomotionRow("standing: speed of the goals", "deg/s", 5.0, still, worst(speed), None),
    ]


def _steady() -> list[LocomotionRow]:
    walk = [Case(16.0, velocity=(SPEED, 0.0, 0.0), changes=friction(1.0))]

    def of_height(which: Callable[[Array], float]) -> Callable[[Case, WalkMotion], float]:
        return lambda _, motion: MM * which(motion.moving_mean(motion.after(6.0).position[:, 2]))

    swing = worst(of_height(lambda height: float(np.ptp(height))))
    return [LocomotionRow("friction 1: swing of the mean height", "mm", 4.0, walk, swing, None)]
