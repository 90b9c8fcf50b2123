"""Rows of what happens at once: corners, curves, steps, pushes, loads, slopes, ramps, stress.

Errors of the place are those of stride means, since the torso sways.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np

from benchmarks.locomotion.cases import (
    PERIOD,
    Case,
    WalkMotion,
    friction,
    incline,
    push,
)
from benchmarks.locomotion.rows import MM, SPEED, LocomotionRow, worst
from slot_core.arrays import Array

AT = 5.0  # s, of what happens at once
PLACE, TURN = 0.003, math.radians(1.0)  # of a robot that has recovered
EDGE = 0.3  # m, of the paths
Events = tuple[tuple[float, str, tuple[float, ...]], ...]


def rows(quick: bool) -> list[LocomotionRow]:
    """All rows."""
    return [
        *_paths(quick),
        *_steps(quick),
        *_pushes(quick),
        *_loads(quick),
        *_postures(),
        *([] if quick else [*_curves(), *_steady(), *_stress(), *_broken()]),
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
        found.append(
            LocomotionRow(f"{name} by path, RMS", "mm", 5.0, cases, worst(_off_path))
        )
    return found


def _off_path(case: Case, motion: WalkMotion) -> float:
    late = motion.after(3.0)
    distance = np.min(
        [_distance(late.position[:, :2], *edge) for edge in _edges(case)], axis=0
    )
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

    steps = {".02 to .06": (0.02, 0.06, 1.2), ".06 to -.04": (0.06, -0.04, 1.5)}
    steps |= {".05 to 0": (0.05, 0.0, 1.2)}
    return [
        LocomotionRow(
            f"velocity {name}: to a tenth", "s", goal, [step(a, b)], worst(settled)
        )
        for name, (a, b, goal) in list(steps.items())[: 1 if quick else None]
    ]


def _pushes(quick: bool) -> list[LocomotionRow]:
    begins = [AT + k * PERIOD / 4 for k in range(1 if quick else 4)]
    force, found = 0.83 / 0.2, []  # N for .2 s
    ways = {"aside": ((0.0, force, 0.0), 1), "back": ((-force, 0.0, 0.0), 0)}
    for name, (way, axis) in list(ways.items())[: 1 if quick else None]:
        cases = [
            Case(
                begin + 4.0,
                "push",
                velocity=(SPEED, 0.0, 0.0),
                changes=push(begin, way),
            )
            for begin in begins
        ]
        title = f"push of .83 N s {name}"
        found += [
            LocomotionRow(f"{title}: peak", "mm", 20.0, cases, worst(_peak(axis)), 1.1),
            LocomotionRow(
                f"{title}: recovery", "s", 2.0, cases, worst(_recovery(axis)), 0.9
            ),
        ]
    return found


def _pushed(case: Case, motion: WalkMotion, axis: int) -> tuple[Array, Array, Array]:
    """Times after the push, and how far the robot is off its way and turned by then."""
    begin = dict(case.changes)["scene.pushes.left.time"]
    wanted = motion.position[:, axis] - case.velocity[axis] * motion.time
    place, yaw = motion.moving_mean(wanted), motion.moving_mean(motion.rpy[:, 2])
    time = motion.time[len(motion.time) - len(place) :] - begin
    start = int(np.searchsorted(time, 0.0))
    return time[start:], place[start:] - place[start], yaw[start:] - yaw[start]


def _peak(axis: int) -> Callable[[Case, WalkMotion], float]:
    return lambda case, motion: MM * float(np.abs(_pushed(case, motion, axis)[1]).max())


def _recovery(axis: int) -> Callable[[Case, WalkMotion], float]:
    def recovery(case: Case, motion: WalkMotion) -> float:
        time, off, turned = _pushed(case, motion, axis)
        away = (np.abs(off) > PLACE) | (np.abs(turned) > TURN)
        return float(time[away].max(initial=0.0))

    return recovery


def _loads(quick: bool) -> list[LocomotionRow]:
    load, none = (0.3, 0.03, 0.02, 0.03), (0.0, 0.0, 0.0, 0.0)
    events: dict[str, Events] = {
        "payload .3 kg off centre": ((AT, "payload", load),),
        "payload .3 kg on, then off": ((1.0, "payload", load), (AT, "payload", none)),
        "slope of 4 deg, up": ((AT, "gravity", incline(4.0, 0.0)),),
        "slope of 4 deg, across": ((AT, "gravity", incline(4.0, 90.0)),),
        "slope of 4 deg, diagonal": ((AT, "gravity", incline(4.0, 45.0)),),
        "slope of 8 deg, up": ((AT, "gravity", incline(8.0, 0.0)),),
        "friction .6 left, .2 right": ((AT, "friction", (0.6, 0.2, 0.6, 0.2)),),
        "friction .5 left, .3 right": ((AT, "friction", (0.5, 0.3, 0.5, 0.3)),),
        "friction .4 to .2": ((AT, "friction", (0.2, 0.2, 0.2, 0.2)),),
    }
    found = []
    for name, happens in list(events.items())[: 1 if quick else None]:
        cases = [Case(AT + 6.0, velocity=(SPEED, 0.0, 0.0), events=happens)]
        found.append(
            LocomotionRow(
                f"{name}, at once: place lost", "mm", 10.0, cases, worst(_lost)
            )
        )
    return found


def _lost(case: Case, motion: WalkMotion) -> float:
    """Largest distance from the line that the robot would have walked on, mm."""
    x, y = (motion.moving_mean(column) for column in motion.position[:, :2].T)
    time = motion.time[len(motion.time) - len(x) :]
    start = int(np.searchsorted(time, AT))
    expected = x[start] + SPEED * (time[start:] - time[start])
    return MM * float(np.hypot(x[start:] - expected, y[start:] - y[start]).max())


def _postures() -> list[LocomotionRow]:
    ramp = Case(
        8.0, gait="stand", pose=(0.060, 0.0, 0.0), poses=((4.0, (0.030, 0.0, 0.0)),)
    )

    def lag(case: Case, motion: WalkMotion) -> float:
        moving = motion.after(4.3, 5.4)  # from 60 to 30 mm at 20 mm/s
        wanted = 0.060 - 0.02 * (moving.time - 4.0)
        return MM * float(np.abs(moving.position[:, 2] - wanted).mean())

    def speed(case: Case, motion: WalkMotion) -> float:
        return math.degrees(motion.after(6.0).goal_speed.mean())

    still = [Case(10.0, gait="stand")]
    return [
        LocomotionRow(
            "standing, ramp of 30 mm: lag", "mm", 2.0, [ramp], worst(lag), None
        ),
        LocomotionRow(
            "standing: speed of the goals", "deg/s", 5.0, still, worst(speed), None
        ),
    ]


def _steady() -> list[LocomotionRow]:
    walk = [Case(16.0, velocity=(SPEED, 0.0, 0.0), changes=friction(1.0))]

    def of_height(
        which: Callable[[Array], float],
    ) -> Callable[[Case, WalkMotion], float]:
        return lambda _, motion: (
            MM * which(motion.moving_mean(motion.after(6.0).position[:, 2]))
        )

    swing = worst(of_height(lambda height: float(np.ptp(height))))
    return [
        LocomotionRow(
            "friction 1: swing of the mean height", "mm", 4.0, walk, swing, None
        )
    ]


def _curves() -> list[LocomotionRow]:
    """Curves by command, and a quarter of a circle of 1 m radius with the heading along it."""
    turning = [Case(16.0, velocity=(0.03, 0.0, rate)) for rate in (0.03, 0.04, 0.05)]

    def missing(case: Case, motion: WalkMotion) -> float:
        wanted = case.velocity[2]
        return 100.0 * abs(motion.after(6.0).velocity[2] - wanted) / wanted

    angle = np.linspace(0.0, math.pi / 2, 60)
    arc = tuple(zip(np.sin(angle).tolist(), (1.0 - np.cos(angle)).tolist()))
    duration = math.pi / 2 / SPEED + 2.0
    circle = [Case(duration, velocity=(SPEED, 0.0, 0.0), path=arc, heading="along")]

    def off(case: Case, motion: WalkMotion) -> float:
        x, y = motion.after(3.0).position[:, :2].T
        return MM * float(np.sqrt(np.mean((np.hypot(x, y - 1.0) - 1.0) ** 2)))

    return [
        LocomotionRow(
            "curves of .03 m/s: yaw rate missed", "%", 10.0, turning, worst(missing)
        ),
        LocomotionRow("circle of 1 m radius, RMS", "mm", 5.0, circle, worst(off)),
    ]


def _stress() -> list[LocomotionRow]:
    """Random velocities, frictions of each foot and payloads."""
    rng, duration = np.random.default_rng(0), 90.0
    most = np.array([0.05, 0.02, 0.03])
    schedule = tuple(
        (time, tuple((most * rng.uniform(-1.0, 1.0, 3)).tolist()))
        for time in np.arange(0.0, duration, 3.0).tolist()
    )
    events: Events = ()
    for time in np.arange(6.0, duration, 9.0).tolist():
        place = rng.uniform([-0.03, -0.03, 0.02], [0.03, 0.03, 0.03]).tolist()
        events += (
            (time, "friction", tuple(rng.uniform(0.2, 0.6, 4).tolist())),
            (time, "payload", (float(rng.uniform(0.0, 0.3)), *place)),
        )
    cases = [Case(duration, schedule=schedule, events=events)]

    def tilt(case: Case, motion: WalkMotion) -> float:
        return math.degrees(motion.tilt.max())

    return [
        LocomotionRow(
            "random stress of 90 s: tilt", "deg", 15.0, cases, worst(tilt), None
        )
    ]


def _broken() -> list[LocomotionRow]:
    """A leg without a tendon, of which the model is told."""
    broken = (True, False, False, False)
    told = (("scene.tendons.broken", broken), ("policy.nominal.broken", broken))
    cases = [Case(16.0, velocity=(0.04, 0.0, 0.0), changes=told)]

    def turned(case: Case, motion: WalkMotion) -> float:
        late = motion.after(5.0)
        return math.degrees(float(abs(late.rpy[-1, 2] - late.rpy[0, 2])))

    return [
        LocomotionRow(
            "tendon FL broken, told: turned", "deg", 5.0, cases, worst(turned)
        )
    ]
