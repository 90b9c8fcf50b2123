"""Rows of the table: what is measured, in which cases, its goal, and the benefit that is required.

Every value is the worst over the cases and the seeds. Errors are those of the true motion after
`WARM_UP`, those of a velocity after `CAUGHT_UP`; heading, drift and return to the path are of means
over a stride, as the torso sways.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.locomotion.cases import (
    PERIOD,
    STRIDES,
    Case,
    Changes,
    Vector3,
    WalkMotion,
    friction,
    payload,
    push,
    slope,
    slow_servos,
    stiffness,
    tendon_errors,
)
from slot_core.robot import read_robot

WARM_UP = 4.0  # s, start of a run, which is not measured
CAUGHT_UP = 6.0  # s, after which the distance lost at the start is regained
SPEED, LENGTH = 0.05, 0.8  # m/s, m: of the straight walks
SIDE = 0.6  # m, of the square
TURN_RATE = 0.15  # rad/s
STEADY_STRIDES = (
    6  # at the end of a turn; before, the angle lost at the start is regained
)
DIRECTION_SPEED = 0.06  # m/s, too fast for the walk when it is slanting
HELD = 0.003  # m/s within which a speed counts as held
DISTURBED = 3.0  # s, time of pushes and of lost odometry
RECOVERED = 3.0  # s, how long the robot has to stay on the path
BODY = (0.040, 0.0, 0.0)  # m, rad: of the posture `stand`
MM, DEG = 1e3, 180 / math.pi

Measure = Callable[[Sequence[Case], Sequence[WalkMotion]], float]


@dataclass(frozen=True)
class LocomotionRow:
    """A row of the table.

    share: largest ratio of the default's value to the gait alone's; the smallest one where larger
    is better. None: without such a check, because the controller does not affect the value.
    """

    name: str
    unit: str
    goal: float
    cases: Sequence[Case]
    measure: Measure
    share: float | None = 0.5
    larger: bool = False

    def value(self, motions: Sequence[WalkMotion]) -> float:
        """The value of a seed; after a fall the worst possible one."""
        if any(motion.fallen for motion in motions):
            return 0.0 if self.larger else math.inf
        return self.measure(self.cases, motions)


def worst(of: Callable[[Case, WalkMotion], float]) -> Measure:
    """The largest value over the cases."""
    return lambda cases, motions: max(of(c, m) for c, m in zip(cases, motions))


def ratio(value: float, other: float) -> float:
    """value / other; NaN, which no check holds for, if it is undefined."""
    if math.isinf(other):
        return math.nan if math.isinf(value) else 0.0
    if other == 0.0:
        return math.nan if value == 0.0 else math.inf
    return value / other


def rows(quick: bool) -> list[LocomotionRow]:
    """All rows."""
    return [
        *_speeds(quick),
        *_straight(),
        *_path(),
        *([] if quick else _square()),
        *_turn(quick),
        *_directions(quick),
        *_standing(quick),
        *_heights(quick),
        *_slopes(quick),
        *_posture(),
        *_disturbed(quick),
    ]


def directions(quick: bool) -> list[Case]:
    """Walks in all directions at one speed, for the row and its plot."""
    angles = np.radians([120] if quick else np.arange(0, 360, 30))
    velocities = DIRECTION_SPEED * np.column_stack([np.cos(angles), np.sin(angles)])
    return [_fast(*velocity) for velocity in velocities.round(6).tolist()]


def _fast(v_x: float, v_y: float = 0.0, changes: Changes = ()) -> Case:
    """The fast walk; measured over 14 strides."""
    duration = CAUGHT_UP + 14 * STRIDES["fast_walk"].period
    return Case(duration, gait="fast_walk", velocity=(v_x, v_y, 0.0), changes=changes)


def square() -> Case:
    """Square of four sides and four turns of 90 deg by velocity commands, then standing."""
    schedule, time = [], 0.0
    for _ in range(4):
        schedule += [
            (time, (SPEED, 0.0, 0.0)),
            (time + SIDE / SPEED, (0.0, 0.0, TURN_RATE)),
        ]
        time += SIDE / SPEED + math.pi / 2 / TURN_RATE
    return Case(time + 2.0, schedule=(*schedule, (time, (0.0, 0.0, 0.0))))


def slanted() -> Case:
    """Path of 60 deg, with the heading kept."""
    end = (LENGTH * math.cos(math.pi / 3), LENGTH * math.sin(math.pi / 3))
    return Case(
        LENGTH / SPEED + 3.0, velocity=(SPEED, 0.0, 0.0), path=((0.0, 0.0), end)
    )


def _speeds(quick: bool) -> list[LocomotionRow]:
    duration = CAUGHT_UP + 10.5  # 15 strides
    commanded = (0.055,) if quick else (0.02, 0.03, 0.04, 0.055)
    held = [
        Case(duration, velocity=(v, 0.0, 0.0), changes=friction(mu))
        for v in commanded
        for mu in ((0.2, 0.6) if quick else (0.2, 0.3, 0.4, 0.6))
    ]
    found = [
        LocomotionRow(
            "v_x held, .02 to .055, mu .2 to .6", "mm/s", 2.0, held, worst(_speed_error)
        )
    ]
    tried = (0.05, 0.055, 0.06, 0.065, 0.07)
    for mu, goal in () if quick else ((0.2, 0.06), (0.4, 0.075), (0.6, 0.08)):
        cases = [
            Case(duration, velocity=(v, 0.0, 0.0), changes=friction(mu)) for v in tried
        ]
        cases += [_fast(v, changes=friction(mu)) for v in (0.075, 0.08)]
        name = f"fastest held, mu {mu:g}"
        found.append(
            LocomotionRow(name, "m/s", goal, cases, _fastest_held, 1.05, larger=True)
        )
    return found


def _straight() -> list[LocomotionRow]:
    equal, split = straight(), straight(friction(0.5, 0.3))
    return [
        LocomotionRow("lateral error over .8 m", "mm", 10.0, [equal], worst(_lateral)),
        LocomotionRow(
            "lateral RMSE over .8 m", "mm", 14.0, [equal], worst(_lateral_rms), None
        ),
        LocomotionRow(
            "lateral error, split friction", "mm", 20.0, [split], worst(_lateral)
        ),
        LocomotionRow("heading, split friction", "deg", 2.0, [split], worst(_heading)),
    ]


def straight(changes: Changes = ()) -> Case:
    """Straight walk of .8 m."""
    return Case(LENGTH / SPEED + 0.5, velocity=(SPEED, 0.0, 0.0), changes=changes)


def _path() -> list[LocomotionRow]:
    def cross_track(case: Case, motion: WalkMotion) -> float:
        x, y = motion.position[:, :2].T
        (dx, dy) = case.path[1]
        if dx * x[-1] + dy * y[-1] < LENGTH**2 / 2:
            return math.inf  # it does not walk
        return float(MM * np.sqrt(np.mean((dx * y - dy * x) ** 2)) / math.hypot(dx, dy))

    case = slanted()
    return [
        LocomotionRow(
            "60 deg path, cross-track RMSE", "mm", 10.0, [case], worst(cross_track)
        ),
        LocomotionRow("60 deg path, heading", "deg", 2.0, [case], worst(_heading)),
    ]


def _square() -> list[LocomotionRow]:
    def gap(case: Case, motion: WalkMotion) -> float:
        if np.ptp(motion.position[:, :2], axis=0).min() < SIDE / 2:
            return math.inf  # it does not walk
        return MM * math.dist(motion.position[-1, :2], motion.position[0, :2])

    def turned(case: Case, motion: WalkMotion) -> float:
        return DEG * float(abs(motion.rpy[-1, 2] - motion.rpy[0, 2] - 2 * math.pi))

    case = square()
    return [
        LocomotionRow("square of .6 m closes", "mm", 50.0, [case], worst(gap)),
        LocomotionRow("square of .6 m, heading", "deg", 5.0, [case], worst(turned)),
    ]


def _turn(quick: bool) -> list[LocomotionRow]:
    quarter = math.pi / 2 / TURN_RATE
    schedule = ((0.0, (0.0, 0.0, TURN_RATE)), (quarter, (0.0, 0.0, 0.0)))
    floors = (0.6,) if quick else (0.2, 0.4, 0.6)
    cases = [
        Case(quarter + 2.0, schedule=schedule, changes=friction(mu)) for mu in floors
    ]

    def rate(case: Case, motion: WalkMotion) -> float:
        late = motion.after(quarter - STEADY_STRIDES * PERIOD, quarter)
        return float(abs(late.velocity[2] - TURN_RATE))

    def angle(case: Case, motion: WalkMotion) -> float:
        return DEG * float(abs(motion.rpy[-1, 2] - motion.rpy[0, 2] - math.pi / 2))

    def drift(case: Case, motion: WalkMotion) -> float:
        away = np.hypot(*(motion.position[:, :2] - motion.position[0, :2]).T)
        return MM * float(motion.moving_mean(away).max())

    return [
        LocomotionRow("turn in place, rate", "rad/s", 0.01, cases, worst(rate)),
        LocomotionRow("turn in place, 90 deg", "deg", 2.0, cases, worst(angle)),
        LocomotionRow("turn in place, drift", "mm", 30.0, cases, worst(drift)),
    ]


def _directions(quick: bool) -> list[LocomotionRow]:
    def error(case: Case, motion: WalkMotion) -> float:
        reached = motion.after(CAUGHT_UP).velocity[:2]
        return MM * math.dist(reached, case.velocity[:2])

    cases = directions(quick)
    return [
        LocomotionRow(
            "v of .06 held in all directions", "mm/s", 3.0, cases, worst(error)
        ),
        LocomotionRow("v of .06, heading", "deg", 2.0, cases, worst(_heading)),
    ]


def _standing(quick: bool) -> list[LocomotionRow]:
    heights = [(h, 0.0, 0.0) for h in (0.030, 0.040, 0.050, 0.060)]
    five = math.radians(5.0)
    tilts = [
        (0.040, five, 0.0),
        (0.040, -five, 0.0),
        (0.040, 0.0, five),
        (0.040, 0.0, -five),
    ]
    places = [
        (0.06, 0.04, 0.02),
        (-0.06, 0.0, 0.02),
        (0.0, 0.04, 0.02),
        (0.0, 0.0, 0.02),
    ]
    slopes = [slope(10.0, 90.0, 0.6), slope(10.0, 0.0, 0.6), slope(5.0, 0.0, 0.4)]
    loads = [payload(0.5, place) for place in places]
    groups: dict[str, list[Case]] = {
        "heights .030 to .060": [_stand(pose) for pose in heights[::-1]],
        "roll and pitch of 5 deg": [_stand(pose) for pose in tilts],
        "payload .5 kg": [_stand(pose, load) for load in loads for pose in heights],
        "slopes to 10 deg": [_stand(BODY, incline) for incline in slopes],
    }
    found = []
    for name, every in groups.items():
        cases = every[: 1 if quick else None]
        # a level torso on equal legs stays level without a controller
        share, row = None if name.startswith("heights") else 0.5, f"standing, {name}"
        found += [
            LocomotionRow(f"{row}: height", "mm", 1.0, cases, worst(_height_off)),
            LocomotionRow(
                f"{row}: angles", "deg", 0.3, cases, worst(_angle_off), share
            ),
        ]
    return found


def _stand(pose: Vector3, changes: Changes = ()) -> Case:
    return Case(4.0, gait="stand", pose=pose, changes=changes)


def _heights(quick: bool) -> list[LocomotionRow]:
    loads = ((), payload(0.3, (-0.04, 0.0, 0.03)), payload(0.3, (0.0, 0.04, 0.02)))
    commanded = (0.070,) if quick else (0.055, 0.0625, 0.070)
    cases = [
        Case(
            WARM_UP + 7.0, velocity=(SPEED, 0.0, 0.0), pose=(h, 0.0, 0.0), changes=load
        )
        for h in commanded
        for load in loads[: 1 if quick else None]
    ]

    def error(case: Case, motion: WalkMotion) -> float:
        assert case.pose is not None
        return MM * float(
            abs(motion.after(WARM_UP).position[:, 2].mean() - case.pose[0])
        )

    return [LocomotionRow("mean height walking, .3 kg", "mm", 3.0, cases, worst(error))]


def _slopes(quick: bool) -> list[LocomotionRow]:
    easy = Case(
        CAUGHT_UP + 10.5, velocity=(0.04, 0.0, 0.0), changes=slope(5.0, 0.0, 0.4)
    )
    steep = _fast(0.03, changes=slope(10.0, 0.0, 0.6))
    cases = {"slope 5 deg, v_x of 0.04": easy, "slope 10 deg, v_x of 0.03": steep}
    return [
        LocomotionRow(name, "mm/s", 3.0, [case], worst(_speed_error))
        for name, case in list(cases.items())[: 1 if quick else None]
    ]


def _posture() -> list[LocomotionRow]:
    def rms(case: Case, motion: WalkMotion) -> float:
        return DEG * float(np.sqrt(np.mean(motion.after(WARM_UP).tilt ** 2)))

    def largest(case: Case, motion: WalkMotion) -> float:
        return DEG * float(motion.after(WARM_UP).tilt.max())

    low = Case(12.0, gait="crawl", velocity=(0.03, 0.0, 0.0))
    return [
        LocomotionRow(
            "tilt of the walk, RMS", "deg", 4.5, [straight()], worst(rms), None
        ),
        LocomotionRow(
            "tilt of the walk, largest", "deg", 8.0, [straight()], worst(largest), None
        ),
        LocomotionRow("crawl, torso's top", "mm", 70.0, [low], worst(_top), None),
    ]


def _disturbed(quick: bool) -> list[LocomotionRow]:
    aside, gap = (0.0, 1.5, 0.0), (DISTURBED, 0.3)
    pushed = push(DISTURBED, aside)
    wrong = tendon_errors(0.5e-3)
    everything = (*pushed, *stiffness(0.8), *slow_servos(2.0), *wrong)
    late = (("scene.sensors.odometry.delay", 0.08),)
    cases = {
        "odometry lost for .3 s": recovery(lost_odometry=gap),
        "push of .3 N s": recovery(pushed, scene="push"),
        "odometry 80 ms late": recovery(late),
        "modulus -35 %": recovery(stiffness(0.65)),
        "modulus -20 %": recovery(stiffness(0.8)),
        "modulus +20 %": recovery(stiffness(1.2)),
        "modulus +50 %": recovery(stiffness(1.5)),
        "servo's lag doubled": recovery(slow_servos(2.0)),
        "tendons +-.5 mm": recovery(wrong),
        "tendons +-1 mm": recovery(tendon_errors(1e-3)),
        "all at once": recovery(everything, scene="push", lost_odometry=gap),
    }
    return [
        LocomotionRow(
            f"{name}: off the path after .8 m", "mm", 10.0, [case], worst(_off_path)
        )
        for name, case in list(cases.items())[: 1 if quick else None]
    ]


def recovery(changes: Changes = (), **others: Any) -> Case:
    """Straight walk with a disturbance, then .8 m to return to the path and some more."""
    return replace(
        straight(changes), duration=DISTURBED + LENGTH / SPEED + RECOVERED, **others
    )


def _speed_error(case: Case, motion: WalkMotion) -> float:
    return MM * abs(motion.after(CAUGHT_UP).forward_speed - case.velocity[0])


def _fastest_held(cases: Sequence[Case], motions: Sequence[WalkMotion]) -> float:
    """Largest of the commanded speeds that is reached but for HELD; 0: none."""
    speeds = [
        (c.velocity[0], m.after(CAUGHT_UP).forward_speed)
        for c, m in zip(cases, motions)
    ]
    return max((v for v, reached in speeds if reached >= v - HELD), default=0.0)


def _walks(case: Case, motion: WalkMotion) -> bool:
    """Whether the robot covers half of the commanded distance: standing is no straight walk."""
    return bool(motion.position[-1, 0] > 0.5 * case.velocity[0] * case.duration)


def _lateral(case: Case, motion: WalkMotion) -> float:
    if not _walks(case, motion):
        return math.inf
    return MM * float(np.abs(motion.position[:, 1]).max())


def _lateral_rms(case: Case, motion: WalkMotion) -> float:
    if not _walks(case, motion):
        return math.inf
    return MM * float(np.sqrt(np.mean(motion.position[:, 1] ** 2)))


def _heading(case: Case, motion: WalkMotion) -> float:
    return DEG * motion.heading


def _off_path(case: Case, motion: WalkMotion) -> float:
    if not _walks(case, motion):
        return math.inf
    late = motion.after(DISTURBED + LENGTH / SPEED)
    return MM * float(np.abs(late.moving_mean(late.position[:, 1])).max())


def _height_off(case: Case, motion: WalkMotion) -> float:
    assert case.pose is not None
    return MM * float(np.abs(motion.after(2.0).position[:, 2] - case.pose[0]).max())


def _angle_off(case: Case, motion: WalkMotion) -> float:
    assert case.pose is not None
    return DEG * float(np.abs(motion.after(2.0).rpy[:, :2] - case.pose[1:]).max())


def _top(case: Case, motion: WalkMotion) -> float:
    """Height of the highest corner of the torso after the start, mm."""
    if not _walks(case, motion):
        return math.inf
    late = motion.after(WARM_UP)
    roll, pitch = late.rpy[:, 0], late.rpy[:, 1]
    upward = np.array(
        [np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)]
    )
    rise = np.array(read_robot().torso.size) / 2 @ np.abs(upward)
    return MM * float((late.position[:, 2] + rise).max())
