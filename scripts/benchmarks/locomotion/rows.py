"""Rows of the table: what is measured, in which cases, its goal, and the benefit that is required.

Every value is the worst over the cases and the seeds. Errors are taken from the true motion after
`WARM_UP`, errors of a velocity after `CAUGHT_UP`; heading, drift, return to the path and places lost
are taken from means over a stride, as the torso sways.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
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
    incline,
    payload,
    push,
    slope,
    slow_servos,
    stiffness,
    tendon_errors,
)
from slot_core.arrays import Array
from slot_core.robot import read_robot

WARM_UP = 4.0  # s, start of a run, which is not measured
CAUGHT_UP = 6.0  # s, after which the distance lost at the start is regained
SPEED, LENGTH = 0.05, 0.8  # m/s, m: of the straight walks
SIDE = 0.6  # m, of the square
TURN_RATE = 0.15  # rad/s
QUARTER = math.pi / 2 / TURN_RATE  # s, of a turn by 90 deg
# at the end of a turn; before, the angle lost at first is regained
STEADY_STRIDES = 6
DIRECTION_SPEED = 0.06  # m/s, too fast for the walk when it is slanting
HELD = 0.003  # m/s within which a speed counts as held
DISTURBED = 3.0  # s, time of pushes and of lost odometry
RECOVERED = 3.0  # s, how long the robot has to stay on the path
BODY = (0.040, 0.0, 0.0)  # m, rad: of the posture `stand`
AT = 5.0  # s, of what happens at once
PLACE, TURN = 0.003, math.radians(1.0)  # of a robot that has recovered
EDGE = 0.3  # m, of the paths
RAMP = (0.060, 0.030, 0.02)  # m, from and to; m/s
MM, DEG = 1e3, 180 / math.pi

Measure = Callable[[Case, WalkMotion], float]
Events = tuple[tuple[float, str, tuple[float, ...]], ...]


@dataclass(frozen=True)
class LocomotionRow:
    """A row of the table.

    quick: the cases that are run with --quick, by number; none: the row is left out.
    share: largest ratio of the default's value to the gait alone's; the smallest one where larger
    is better. None: without such a check, because the controller does not affect the value.
    must_walk: a robot that covers less than half of the commanded distance has the worst value.
    larger: larger is better, and the value is the largest commanded speed that is held.
    """

    name: str
    unit: str
    goal: float
    cases: Sequence[Case]
    measure: Measure
    quick: Sequence[int] = ()
    share: float | None = 0.5
    must_walk: bool = False
    larger: bool = False

    def value(self, motions: Sequence[WalkMotion]) -> float:
        """The value of a seed; after a fall the worst possible one."""
        pairs = list(zip(self.cases, motions))
        if any(motion.fallen for motion in motions):
            return 0.0 if self.larger else math.inf
        if self.must_walk and not all(
            m.position[-1, 0] > 0.5 * c.velocity[0] * c.duration
            for c, m in pairs
        ):
            return math.inf
        if self.larger:
            return max(
                [c.velocity[0] for c, m in pairs if self.measure(c, m) <= HELD],
                default=0.0,
            )
        return max(self.measure(case, motion) for case, motion in pairs)


def ratio(value: float, other: float) -> float:
    """value / other; NaN, which no check holds for, if it is undefined."""
    if math.isinf(other):
        return math.nan if math.isinf(value) else 0.0
    if other == 0.0:
        return math.nan if value == 0.0 else math.inf
    return value / other


def rows(quick: bool) -> list[LocomotionRow]:
    """All rows, or with `quick` some of them with some of their cases."""
    every = [*_walking(), *_standing(), *_disturbed(), *_at_once()]
    if not quick:
        return every
    return [
        replace(
            row,
            cases=[row.cases[k] for k in row.quick],
            quick=range(len(row.quick)),
        )
        for row in every
        if row.quick
    ]


def fast(v_x: float, v_y: float = 0.0, changes: Changes = ()) -> Case:
    """The fast walk; measured over 14 strides."""
    return Case(
        CAUGHT_UP + 14 * STRIDES["fast_walk"].period,
        gait="fast_walk",
        velocity=(v_x, v_y, 0.0),
        changes=changes,
    )


def directions() -> list[Case]:
    """Walks in all directions at one speed, for the row and its plot."""
    angles = np.radians(np.arange(0, 360, 30))
    velocities = DIRECTION_SPEED * np.column_stack(
        [np.cos(angles), np.sin(angles)]
    )
    return [fast(*velocity) for velocity in velocities.round(6).tolist()]


def square() -> Case:
    """Square of four sides and four turns of 90 deg by velocity commands, then standing."""
    schedule, time = [], 0.0
    for _ in range(4):
        schedule.append((time, (SPEED, 0.0, 0.0)))
        schedule.append((time + SIDE / SPEED, (0.0, 0.0, TURN_RATE)))
        time += SIDE / SPEED + QUARTER
    return Case(time + 2.0, schedule=(*schedule, (time, (0.0, 0.0, 0.0))))


def slanted() -> Case:
    """Path of 60 deg, with the heading kept."""
    end = (LENGTH * math.cos(math.pi / 3), LENGTH * math.sin(math.pi / 3))
    return Case(
        LENGTH / SPEED + 3.0, velocity=(SPEED, 0.0, 0.0), path=((0.0, 0.0), end)
    )


def straight(changes: Changes = (), **others: Any) -> Case:
    """Straight walk of .8 m."""
    return replace(
        Case(LENGTH / SPEED + 0.5, velocity=(SPEED, 0.0, 0.0), changes=changes),
        **others,
    )


def _walking() -> list[LocomotionRow]:
    """Speeds, paths, turns, directions, curves and slopes."""
    duration = CAUGHT_UP + 10.5  # 15 strides
    held = [
        Case(duration, velocity=(v, 0.0, 0.0), changes=friction(mu))
        for v in (0.02, 0.03, 0.04, 0.055)
        for mu in (0.2, 0.3, 0.4, 0.6)
    ]
    tried = {
        mu: [
            *(
                Case(duration, velocity=(v, 0.0, 0.0), changes=friction(mu))
                for v in (0.05, 0.055, 0.06, 0.065, 0.07)
            ),
            *(fast(v, changes=friction(mu)) for v in (0.075, 0.08)),
        ]
        for mu in (0.2, 0.4, 0.6)
    }
    schedule = ((0.0, (0.0, 0.0, TURN_RATE)), (QUARTER, (0.0, 0.0, 0.0)))
    turns = [
        Case(QUARTER + 2.0, schedule=schedule, changes=friction(mu))
        for mu in (0.2, 0.4, 0.6)
    ]
    quarter = partial(_turn_missed, turn=math.pi / 2)
    corner = ((0.0, 0.0), (EDGE, 0.0), (EDGE, EDGE))
    paths = {
        name: [
            Case(
                EDGE * (len(path) - 1) / SPEED + 3.5,
                velocity=(SPEED, 0.0, 0.0),
                path=path,
                changes=friction(mu),
            )
            for mu in (0.2, 0.4, 0.6)
        ]
        for name, path in (
            ("corner", corner),
            ("square", (*corner, (0.0, EDGE), (0.0, 0.0))),
        )
    }
    curves = [
        Case(16.0, velocity=(0.03, 0.0, rate)) for rate in (0.03, 0.04, 0.05)
    ]
    angle = np.linspace(0.0, math.pi / 2, 60)
    circle = Case(
        math.pi / 2 / SPEED + 2.0,
        velocity=(SPEED, 0.0, 0.0),
        path=tuple(zip(np.sin(angle).tolist(), (1.0 - np.cos(angle)).tolist())),
        heading="along",
    )
    loads = (
        (),
        payload(0.3, (-0.04, 0.0, 0.03)),
        payload(0.3, (0.0, 0.04, 0.02)),
    )
    high = [
        Case(
            WARM_UP + 7.0,
            velocity=(SPEED, 0.0, 0.0),
            pose=(h, 0.0, 0.0),
            changes=load,
        )
        for h in (0.055, 0.0625, 0.070)
        for load in loads
    ]
    easy = Case(
        duration, velocity=(0.04, 0.0, 0.0), changes=slope(5.0, 0.0, 0.4)
    )
    steep = fast(0.03, changes=slope(10.0, 0.0, 0.6))
    equal, split = [straight()], [straight(friction(0.5, 0.3))]
    low = [Case(12.0, gait="crawl", velocity=(0.03, 0.0, 0.0))]
    rough = [Case(16.0, velocity=(SPEED, 0.0, 0.0), changes=friction(1.0))]
    row = LocomotionRow
    walk = {"quick": (0,), "must_walk": True}
    return [
        row(
            "v_x held, .02 to .055, mu .2 to .6",
            "mm/s",
            2.0,
            held,
            _speed_error,
            (12, 15),
        ),
        *(
            row(
                f"fastest held, mu {mu:g}",
                "m/s",
                goal,
                tried[mu],
                _behind,
                share=1.05,
                larger=True,
            )
            for mu, goal in ((0.2, 0.06), (0.4, 0.075), (0.6, 0.08))
        ),
        row("lateral error over .8 m", "mm", 10.0, equal, _lateral, **walk),
        row(
            "lateral RMSE over .8 m",
            "mm",
            14.0,
            equal,
            _lateral_rms,
            share=None,
            **walk,
        ),
        row(
            "lateral error, split friction", "mm", 20.0, split, _lateral, **walk
        ),
        row("heading, split friction", "deg", 2.0, split, _heading, (0,)),
        row(
            "60 deg path, cross-track RMSE",
            "mm",
            10.0,
            [slanted()],
            _cross_track,
            (0,),
        ),
        row("60 deg path, heading", "deg", 2.0, [slanted()], _heading, (0,)),
        row("square of .6 m closes", "mm", 50.0, [square()], _gap),
        row("square of .6 m, heading", "deg", 5.0, [square()], _turn_missed),
        row(
            "turn in place, rate", "rad/s", 0.01, turns, _turn_rate_missed, (2,)
        ),
        row("turn in place, 90 deg", "deg", 2.0, turns, quarter, (2,)),
        row("turn in place, drift", "mm", 30.0, turns, _drift, (2,)),
        row(
            "v of .06 held in all directions",
            "mm/s",
            3.0,
            directions(),
            _direction_error,
            (4,),
        ),
        row("v of .06, heading", "deg", 2.0, directions(), _heading, (4,)),
        row(
            "corner by path, RMS", "mm", 5.0, paths["corner"], _off_edges, (1,)
        ),
        row("square by path, RMS", "mm", 5.0, paths["square"], _off_edges),
        row(
            "curves of .03 m/s: yaw rate missed",
            "%",
            10.0,
            curves,
            _curve_missed,
        ),
        row("circle of 1 m radius, RMS", "mm", 5.0, [circle], _off_circle),
        row(
            "mean height walking, .3 kg",
            "mm",
            3.0,
            high,
            _mean_height_off,
            (6,),
        ),
        row(
            "slope 5 deg, v_x of 0.04", "mm/s", 3.0, [easy], _speed_error, (0,)
        ),
        row("slope 10 deg, v_x of 0.03", "mm/s", 3.0, [steep], _speed_error),
        row("tilt of the walk, RMS", "deg", 4.5, equal, _tilt_rms, (0,), None),
        row(
            "tilt of the walk, largest",
            "deg",
            8.0,
            equal,
            _tilt_largest,
            (0,),
            None,
        ),
        row("crawl, torso's top", "mm", 70.0, low, _top, share=None, **walk),
        row("friction 1: speed missed", "mm/s", 3.0, rough, _speed_error),
        row(
            "friction 1: swing of the mean height",
            "mm",
            4.0,
            rough,
            _height_swing,
            (),
            None,
        ),
    ]


def _standing() -> list[LocomotionRow]:
    """Postures on a level floor, with payload and on slopes; a ramp of the height."""
    heights = [(h, 0.0, 0.0) for h in (0.030, 0.040, 0.050, 0.060)]
    five = math.radians(5.0)
    tilts = [
        (0.040, *tilt)
        for tilt in ((five, 0.0), (-five, 0.0), (0.0, five), (0.0, -five))
    ]
    places = ((0.06, 0.04), (-0.06, 0.0), (0.0, 0.04), (0.0, 0.0))
    slopes = [
        slope(10.0, 90.0, 0.6),
        slope(10.0, 0.0, 0.6),
        slope(5.0, 0.0, 0.4),
    ]
    loads = [payload(0.5, (*place, 0.02)) for place in places]
    groups: dict[str, list[Case]] = {
        "heights .030 to .060": [_stand(pose) for pose in heights[::-1]],
        "roll and pitch of 5 deg": [_stand(pose) for pose in tilts],
        "payload .5 kg": [
            _stand(pose, load) for load in loads for pose in heights
        ],
        "slopes to 10 deg": [_stand(BODY, incline) for incline in slopes],
    }
    found = []
    for name, cases in groups.items():
        # a level torso on equal legs stays level without a controller
        share = None if name.startswith("heights") else 0.5
        found += [
            LocomotionRow(
                f"standing, {name}: height", "mm", 1.0, cases, _height_off, (0,)
            ),
            LocomotionRow(
                f"standing, {name}: angles",
                "deg",
                0.3,
                cases,
                _angle_off,
                (0,),
                share,
            ),
        ]
    begin, end, _ = RAMP
    ramp = Case(
        8.0,
        gait="stand",
        pose=(begin, 0.0, 0.0),
        poses=((4.0, (end, 0.0, 0.0)),),
    )
    return [
        *found,
        LocomotionRow(
            "standing, ramp of 30 mm: lag",
            "mm",
            2.0,
            [ramp],
            _ramp_lag,
            (0,),
            None,
        ),
        LocomotionRow(
            "standing: speed of the goals",
            "deg/s",
            5.0,
            [Case(10.0, gait="stand")],
            _goal_speed,
            (0,),
            None,
        ),
    ]


def _stand(pose: Vector3, changes: Changes = ()) -> Case:
    return Case(12.0, gait="stand", pose=pose, changes=changes)


def _disturbed() -> list[LocomotionRow]:
    """Straight walks with a disturbance, then .8 m to return to the path and some more."""
    gap = (DISTURBED, 0.3)
    pushed = push(DISTURBED, (0.0, 1.5, 0.0))
    wrong = tendon_errors(0.5e-3)
    everything = (*pushed, *stiffness(0.8), *slow_servos(2.0), *wrong)
    late = (("scene.sensors.odometry.delay", 0.08),)
    walk = partial(straight, duration=DISTURBED + LENGTH / SPEED + RECOVERED)
    cases = {
        "odometry lost for .3 s": walk(lost_odometry=gap),
        "push of .3 N s": walk(pushed, scene="push"),
        "odometry 80 ms late": walk(late),
        "modulus -35 %": walk(stiffness(0.65)),
        "modulus -20 %": walk(stiffness(0.8)),
        "modulus +20 %": walk(stiffness(1.2)),
        "modulus +50 %": walk(stiffness(1.5)),
        "servo's lag doubled": walk(slow_servos(2.0)),
        "tendons +-.5 mm": walk(wrong),
        "tendons +-1 mm": walk(tendon_errors(1e-3)),
        "all at once": walk(everything, scene="push", lost_odometry=gap),
    }
    return [
        LocomotionRow(
            f"{name}: off the path after .8 m",
            "mm",
            10.0,
            [case],
            _off_line,
            () if k else (0,),
            must_walk=True,
        )
        for k, (name, case) in enumerate(cases.items())
    ]


def _at_once() -> list[LocomotionRow]:
    """Sudden changes: steps of the velocity, pushes, loads, slopes, frictions; stress."""
    steps = {
        ".02 to .06": (0.02, 0.06, 1.2),
        ".06 to -.04": (0.06, -0.04, 1.5),
        ".05 to 0": (0.05, 0.0, 1.2),
    }
    found = []
    for name, (before, after, goal) in steps.items():
        case = Case(
            AT + 4.0,
            schedule=((0.0, (before, 0.0, 0.0)), (AT, (after, 0.0, 0.0))),
        )
        title = f"velocity {name}: to a tenth"
        quick = () if found else (0,)
        found.append(LocomotionRow(title, "s", goal, [case], _settled, quick))
    force = 0.83 / 0.2  # N for .2 s
    ways = {"aside": ((0.0, force, 0.0), 1), "back": ((-force, 0.0, 0.0), 0)}
    for name, (way, axis) in ways.items():
        cases = [
            straight(push(begin, way), scene="push", duration=begin + 4.0)
            for begin in (AT + k * PERIOD / 4 for k in range(4))
        ]
        quick = (0,) if name == "aside" else ()
        found += [
            LocomotionRow(
                f"push of .83 N s {name}: peak",
                "mm",
                20.0,
                cases,
                partial(_peak, axis),
                quick,
                1.1,
            ),
            LocomotionRow(
                f"push of .83 N s {name}: recovery",
                "s",
                2.0,
                cases,
                partial(_recovery, axis),
                quick,
                0.9,
            ),
        ]
    load, none = (0.3, 0.03, 0.02, 0.03), (0.0, 0.0, 0.0, 0.0)
    events: dict[str, Events] = {
        "payload .3 kg off centre": ((AT, "payload", load),),
        "payload .3 kg on, then off": (
            (1.0, "payload", load),
            (AT, "payload", none),
        ),
        "slope of 4 deg, up": ((AT, "gravity", incline(4.0, 0.0)),),
        "slope of 4 deg, across": ((AT, "gravity", incline(4.0, 90.0)),),
        "slope of 4 deg, diagonal": ((AT, "gravity", incline(4.0, 45.0)),),
        "slope of 8 deg, up": ((AT, "gravity", incline(8.0, 0.0)),),
        "friction .6 left, .2 right": ((AT, "friction", (0.6, 0.2, 0.6, 0.2)),),
        "friction .5 left, .3 right": ((AT, "friction", (0.5, 0.3, 0.5, 0.3)),),
        "friction .4 to .2": ((AT, "friction", (0.2, 0.2, 0.2, 0.2)),),
    }
    for name, happens in events.items():
        title = f"{name}, at once: place lost"
        cases = [straight(duration=AT + 6.0, events=happens)]
        quick = (0,) if name == "payload .3 kg off centre" else ()
        found.append(LocomotionRow(title, "mm", 10.0, cases, _lost, quick))
    broken = (True, False, False, False)
    told = (("scene.tendons.broken", broken), ("policy.nominal.broken", broken))
    lame = Case(16.0, velocity=(0.04, 0.0, 0.0), changes=told)
    return [
        *found,
        LocomotionRow(
            "random stress of 90 s: tilt",
            "deg",
            15.0,
            [_stress()],
            partial(_tilt_largest, begin=0.0),
            (),
            None,
        ),
        LocomotionRow(
            "tendon FL broken, told: turned",
            "deg",
            5.0,
            [lame],
            partial(_turn_missed, turn=0.0, begin=5.0),
        ),
    ]


def _stress() -> Case:
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
        feet = tuple(rng.uniform(0.2, 0.6, 4).tolist())
        load = (float(rng.uniform(0.0, 0.3)), *place)
        events += ((time, "friction", feet), (time, "payload", load))
    return Case(duration, schedule=schedule, events=events)


def _speed_error(case: Case, motion: WalkMotion) -> float:
    return MM * abs(motion.after(CAUGHT_UP).forward_speed - case.velocity[0])


def _behind(case: Case, motion: WalkMotion) -> float:
    return case.velocity[0] - motion.after(CAUGHT_UP).forward_speed


def _lateral(case: Case, motion: WalkMotion) -> float:
    return MM * float(np.abs(motion.position[:, 1]).max())


def _lateral_rms(case: Case, motion: WalkMotion) -> float:
    return MM * float(np.sqrt(np.mean(motion.position[:, 1] ** 2)))


def _heading(case: Case, motion: WalkMotion) -> float:
    return DEG * motion.heading


def _off_line(case: Case, motion: WalkMotion) -> float:
    late = motion.after(DISTURBED + LENGTH / SPEED)
    return MM * float(np.abs(late.moving_mean(late.position[:, 1])).max())


def _cross_track(case: Case, motion: WalkMotion) -> float:
    x, y = motion.position[:, :2].T
    (dx, dy) = case.path[1]
    if dx * x[-1] + dy * y[-1] < LENGTH**2 / 2:
        return math.inf  # it does not walk
    return float(
        MM * np.sqrt(np.mean((dx * y - dy * x) ** 2)) / math.hypot(dx, dy)
    )


def _gap(case: Case, motion: WalkMotion) -> float:
    if np.ptp(motion.position[:, :2], axis=0).min() < SIDE / 2:
        return math.inf  # it does not walk
    return MM * math.dist(motion.position[-1, :2], motion.position[0, :2])


def _turn_missed(
    case: Case,
    motion: WalkMotion,
    turn: float = 2 * math.pi,
    begin: float = 0.0,
) -> float:
    yaw = motion.after(begin).rpy[:, 2]
    return DEG * float(abs(yaw[-1] - yaw[0] - turn))


def _turn_rate_missed(case: Case, motion: WalkMotion) -> float:
    late = motion.after(QUARTER - STEADY_STRIDES * PERIOD, QUARTER)
    return float(abs(late.velocity[2] - TURN_RATE))


def _drift(case: Case, motion: WalkMotion) -> float:
    away = np.hypot(*(motion.position[:, :2] - motion.position[0, :2]).T)
    return MM * float(motion.moving_mean(away).max())


def _direction_error(case: Case, motion: WalkMotion) -> float:
    return MM * math.dist(
        motion.after(CAUGHT_UP).velocity[:2], case.velocity[:2]
    )


def _off_edges(case: Case, motion: WalkMotion) -> float:
    """Distance from the nearest edge of the path, RMS, mm."""
    places, away = motion.after(3.0).position[:, :2], []
    for begin, end in itertools.pairwise(map(np.array, case.path)):
        along = end - begin
        share = np.clip((places - begin) @ along / (along @ along), 0.0, 1.0)
        away.append(np.hypot(*(places - begin - share[:, None] * along).T))
    return MM * float(np.sqrt(np.mean(np.min(away, axis=0) ** 2)))


def _curve_missed(case: Case, motion: WalkMotion) -> float:
    wanted = case.velocity[2]
    return 100.0 * abs(motion.after(6.0).velocity[2] - wanted) / wanted


def _off_circle(case: Case, motion: WalkMotion) -> float:
    x, y = motion.after(3.0).position[:, :2].T
    return MM * float(np.sqrt(np.mean((np.hypot(x, y - 1.0) - 1.0) ** 2)))


def _mean_height_off(case: Case, motion: WalkMotion) -> float:
    assert case.pose is not None
    return MM * float(
        abs(motion.after(WARM_UP).position[:, 2].mean() - case.pose[0])
    )


def _tilt_rms(case: Case, motion: WalkMotion) -> float:
    return DEG * float(np.sqrt(np.mean(motion.after(WARM_UP).tilt ** 2)))


def _tilt_largest(
    case: Case, motion: WalkMotion, begin: float = WARM_UP
) -> float:
    return DEG * float(motion.after(begin).tilt.max())


def _top(case: Case, motion: WalkMotion) -> float:
    """Height of the highest corner of the torso after the start, mm."""
    late = motion.after(WARM_UP)
    roll, pitch, _ = late.rpy.T
    level = np.cos(pitch)
    upward = np.array(
        [np.sin(pitch), level * np.sin(roll), level * np.cos(roll)]
    )
    rise = np.array(read_robot().torso.size) / 2 @ np.abs(upward)
    return MM * float((late.position[:, 2] + rise).max())


def _height_swing(case: Case, motion: WalkMotion) -> float:
    return MM * float(
        np.ptp(motion.moving_mean(motion.after(6.0).position[:, 2]))
    )


def _height_off(case: Case, motion: WalkMotion) -> float:
    assert case.pose is not None
    return MM * float(
        np.abs(motion.after(2.0).position[:, 2] - case.pose[0]).max()
    )


def _angle_off(case: Case, motion: WalkMotion) -> float:
    assert case.pose is not None
    return DEG * float(
        np.abs(motion.after(2.0).rpy[:, :2] - case.pose[1:]).max()
    )


def _ramp_lag(case: Case, motion: WalkMotion) -> float:
    moving, (begin, _, speed) = motion.after(4.3, 5.4), RAMP
    wanted = begin - speed * (moving.time - 4.0)
    return MM * float(np.abs(moving.position[:, 2] - wanted).mean())


def _goal_speed(case: Case, motion: WalkMotion) -> float:
    return math.degrees(motion.after(6.0).goal_speed.mean())


def _settled(case: Case, motion: WalkMotion) -> float:
    """Time until the mean velocity over a stride stays within a tenth of the step."""
    (_, before), (begin, after) = case.schedule
    moved = motion.moving_mean(motion.position[:, 0])
    time = motion.time[len(motion.time) - len(moved) :]
    off = np.abs(np.gradient(moved, time) - after[0]) > 0.1 * abs(
        after[0] - before[0]
    )
    return float(time[off].max(initial=begin) - begin)


def _pushed(
    axis: int, case: Case, motion: WalkMotion
) -> tuple[Array, Array, Array]:
    """Times after the push, and how far the robot is off its way and turned by then."""
    begin = dict(case.changes)["scene.pushes.left.time"]
    wanted = motion.position[:, axis] - case.velocity[axis] * motion.time
    place, yaw = (
        motion.moving_mean(wanted),
        motion.moving_mean(motion.rpy[:, 2]),
    )
    time = motion.time[len(motion.time) - len(place) :] - begin
    start = int(np.searchsorted(time, 0.0))
    return time[start:], place[start:] - place[start], yaw[start:] - yaw[start]


def _peak(axis: int, case: Case, motion: WalkMotion) -> float:
    return MM * float(np.abs(_pushed(axis, case, motion)[1]).max())


def _recovery(axis: int, case: Case, motion: WalkMotion) -> float:
    time, off, turned = _pushed(axis, case, motion)
    away = (np.abs(off) > PLACE) | (np.abs(turned) > TURN)
    return float(time[away].max(initial=0.0))


def _lost(case: Case, motion: WalkMotion) -> float:
    """Largest distance from the line that the robot would have walked on, mm."""
    x, y = (motion.moving_mean(column) for column in motion.position[:, :2].T)
    time = motion.time[len(motion.time) - len(x) :]
    start = int(np.searchsorted(time, AT))
    expected = x[start] + SPEED * (time[start:] - time[start])
    return MM * float(
        np.hypot(x[start:] - expected, y[start:] - y[start]).max()
    )
