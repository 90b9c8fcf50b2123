"""Runs of the closed loop: a case, the controllers that it is run with, and its motion."""

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import LOCKSTEP_START, to_seconds
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.dynamics.servo import read_servo
from slot_core.gait.gait import mean_velocity, read_gaits
from slot_core.gait.route import Route
from slot_core.refusal import DivergenceError
from slot_core.robot import GRAVITY, read_robot
from slot_core.safety.settings import read_supervisor
from slot_core.simulation.closed_loop import ClosedLoop, PlantMaker
from slot_core.simulation.plant import RobotSimulator

DT = read_gaits().dt  # s, between ticks
STRIDES = read_gaits().strides
PERIOD = STRIDES["walk"].period  # s
FALLEN = read_supervisor().estimate.tilt_max  # rad
PUSH_TIME = 0.2  # s
# of a motion, over its ticks
COURSES = ("time", "position", "rpy", "torque", "goal_speed")
Vector3 = tuple[float, float, float]
Changes = tuple[tuple[str, Any], ...]  # dotted names and values, hashable

ALONE, PAPER, LEARNED, DEFAULT = "gait alone", "paper", "learned", "default"
COLUMNS: Mapping[str, str] = {  # policies by the name of their column
    ALONE: "gait_alone",
    "place": "place",
    LEARNED: f"onnx:{Path(__file__).with_name('walk.onnx')}",  # learned by the example
    DEFAULT: DEFAULT_POLICY,
    PAPER: "paper_text",
    "paper_code": "paper_code",
}
PAPERS = (PAPER, "paper_code")


@dataclass(frozen=True)
class Case:
    """A run of the closed loop; the robot stands at first.

    A velocity that the gait refuses is commanded as the largest that it takes, and missed by so
    much.
    """

    duration: float  # s
    scene: str = "flat"
    gait: str = "walk"
    velocity: Vector3 = (0.0, 0.0, 0.0)
    schedule: tuple[
        tuple[float, Vector3], ...
    ] = ()  # times (s) and velocities from then on
    # height (m), roll, pitch (rad); None: the gait's own
    pose: Vector3 | None = None
    path: tuple[
        tuple[float, float], ...
    ] = ()  # followed at the speed of `velocity`
    heading: str = "kept"  # on the path, or "along"
    changes: Changes = ()  # of the policy: for the default alone
    lost_odometry: tuple[float, float] = (0.0, 0.0)  # begin and duration, s
    # times (s), names and values of the simulated robot's model that change then
    events: tuple[tuple[float, str, tuple[float, ...]], ...] = ()
    poses: tuple[
        tuple[float, Vector3], ...
    ] = ()  # times (s) and body poses from then on


@dataclass(frozen=True)
class WalkMotion:
    """True motion of the torso at the ticks 0, 1 .. n-1; `fallen`: tilted too far or diverged."""

    time: Array  # (n,) s
    position: Array  # (n, 3) m, in odom
    rpy: Array  # (n, 3) rad, the yaw unwrapped
    torque: Array  # (n,) N m, mean over the servos
    # (n,) rad/s, mean speed of the commanded angles over the servos
    goal_speed: Array
    fallen: bool
    period: float = PERIOD  # s, of a stride: for means over strides

    def after(self, begin: float, end: float = math.inf) -> "WalkMotion":
        """The motion from `begin` to `end`, s."""
        part = (self.time >= begin) & (self.time <= end)
        courses = {name: getattr(self, name)[part] for name in COURSES}
        return dataclasses.replace(self, **courses)

    @property
    def tilt(self) -> Array:
        """(n,) rad, between body z and the vertical of odom."""
        return np.arccos(np.cos(self.rpy[:, 0]) * np.cos(self.rpy[:, 1]))

    @property
    def velocity(self) -> Array:
        """Mean velocity (3,) in odom over whole strides at the end: v_x, v_y, yaw rate."""
        pose = np.column_stack([self.position[:, :2], self.rpy[:, 2]])
        whole = (
            math.floor((self.time[-1] - self.time[0]) / self.period)
            * self.period
        )
        first = round(whole / DT)
        return (pose[-1] - pose[-1 - first]) / (
            self.time[-1] - self.time[-1 - first]
        )

    @property
    def forward_speed(self) -> float:
        """Mean velocity along the torso's own heading, m/s."""
        pose = np.column_stack([self.position[:, :2], self.rpy[:, 2]])
        return float(mean_velocity(self.time, pose)[0])

    def moving_mean(self, values: Array) -> Array:
        """Moving mean of values (n,) over a stride."""
        count = min(round(self.period / DT), len(values))
        return np.convolve(values, np.full(count, 1.0 / count), "valid")

    @property
    def heading(self) -> float:
        """Largest stride mean of |yaw|, rad."""
        return float(np.abs(self.moving_mean(self.rpy[:, 2])).max())


Job = tuple[Case, str, int]  # case, column, seed


def run_job(job: Job) -> tuple[Job, WalkMotion]:
    """The job and its motion, for processes that return results in any order."""
    return job, run_case(*job)


def read_motion(fields: Mapping[str, Any]) -> WalkMotion:
    """A motion whose arrays are lists."""
    arrays = {name: np.array(fields[name]) for name in COURSES}
    return WalkMotion(**(dict(fields) | arrays))


def run_case(
    case: Case, column: str, seed: int, make: PlantMaker = RobotSimulator
) -> WalkMotion:
    """Run a case with the controller of a column; `make` builds the robot."""
    path = Route(np.array(case.path), case.heading) if case.path else None
    changes = {
        name: value
        for name, value in case.changes
        if column == DEFAULT or not name.startswith("policy.")
    }
    loop = ClosedLoop(
        case.scene,
        case.gait,
        reachable(case.gait, case.velocity),
        seed,
        COLUMNS[column],
        changes=changes,
        path=path,
        lost_odometry=case.lost_odometry,
        make=make,
    )
    scheduler, sim, rows, fallen = (
        loop.controller.scheduler,
        loop.plant.robot,
        [],
        False,
    )
    schedule, events, poses = [*case.schedule], [*case.events], [*case.poses]
    last: Array | None = None
    if case.pose is not None:
        scheduler.set_pose(np.array(case.pose))
    try:
        for tick in loop.run(round(case.duration / DT)):
            time, angle = (
                to_seconds(loop.plant.now - LOCKSTEP_START),
                tick.command.angle,
            )
            speed = (
                0.0 if last is None else float(np.abs(angle - last).mean()) / DT
            )
            rows.append(
                [time, *sim.position, *sim.rpy, sim.servo_torque.mean(), speed]
            )
            last = angle.copy()
            if schedule and time >= schedule[0][0]:
                scheduler.request(
                    case.gait, reachable(case.gait, schedule.pop(0)[1])
                )
            if poses and time >= poses[0][0]:
                scheduler.set_pose(np.array(poses.pop(0)[1]))
            while events and time >= events[0][0]:
                _, name, value = events.pop(0)
                getattr(sim.model, name)[...] = value
    except DivergenceError:
        fallen = True
    return motion_of(
        np.array(rows), fallen, STRIDES.get(case.gait, STRIDES["walk"]).period
    )


def reachable(gait: str, velocity: Vector3) -> Array:
    """The velocity, or the largest one that a stride takes in its place."""
    if gait not in STRIDES:
        return np.array(velocity)
    stride = STRIDES[gait]
    return stride.reached(
        np.clip(velocity, np.negative(stride.speeds), stride.speeds)
    )


def motion_of(rows: Array, fallen: bool, period: float) -> WalkMotion:
    """Motion of rows (n, 9), time first, then the fields of a motion; gaps are closed linearly."""
    rows[:, 6] = np.unwrap(rows[:, 6])
    time = np.arange(0.0, rows[-1, 0] + DT / 2, DT)
    even = np.column_stack(
        [np.interp(time, rows[:, 0], column) for column in rows.T[1:]]
    )
    motion = WalkMotion(
        time, even[:, :3], even[:, 3:6], even[:, 6], even[:, 7], fallen, period
    )
    return dataclasses.replace(
        motion, fallen=fallen or bool(motion.tilt.max() > FALLEN)
    )


def friction(left: float, right: float | None = None) -> Changes:
    """Floor with a friction coefficient at the left feet, and the same or another at the right."""
    other = left if right is None else right
    return (("scene.floor.friction", (left, other, left, other)),)


def slope(degrees: float, direction_deg: float, mu: float) -> Changes:
    """Incline, uphill in a direction from +x."""
    return (("scene.gravity", incline(degrees, direction_deg)), *friction(mu))


def incline(degrees: float, direction_deg: float) -> Vector3:
    """Gravity where the floor rises in a direction from +x; z stays normal to the floor."""
    tilt, way = math.radians(degrees), math.radians(direction_deg)
    down = -GRAVITY * math.sin(tilt)
    return (
        down * math.cos(way),
        down * math.sin(way),
        -GRAVITY * math.cos(tilt),
    )


def payload(mass: float, place: Vector3) -> Changes:
    """A point mass on the torso."""
    return (("scene.payload.mass", mass), ("scene.payload.place", place))


def stiffness(factor: float) -> Changes:
    """Legs whose modulus is not the controller's."""
    return (
        ("robot.leg.young_modulus", factor * read_robot().leg.young_modulus),
    )


def slow_servos(factor: float) -> Changes:
    """Servos with a longer time constant of their position loop, as stiff under load as before.

    Model `torque_speed`: lag. Model `pid`: (1 / w0 + k_d) / k_p, with the no-load speed w0.
    """
    servo = read_servo()
    loss = 1.0 / float(servo.tendon_speed(servo.nominal_voltage))  # s/rad
    return (
        ("servo.lag", factor * servo.lag),
        ("servo.derivative", factor * (loss + servo.derivative) - loss),
        ("servo.motor_time", factor * servo.motor_time),
    )


def weak_servos(factor: float) -> Changes:
    """Servos of another stall torque."""
    return (
        (
            "servo.stall_torque",
            tuple(factor * torque for torque in read_servo().stall_torque),
        ),
    )


def guides(mu: float) -> Changes:
    """Guides of the tendons with another friction coefficient."""
    return (("robot.tendon.guide_friction", mu),)


def tendon_errors(error: float) -> Changes:
    """Tendons longer by `error` (m) at the left legs and shorter at the right ones."""
    nominal = read_robot().tendon.slack
    longer = (2 * error, 0.0, 2 * error, 0.0)
    return (
        ("robot.tendon.slack", nominal - error),
        ("scene.tendons.slack", longer),
    )


def push(time: float, force: Vector3) -> Changes:
    """A force (N, in odom) on the torso's centre for .2 s, in the scene `push`."""
    return (
        ("scene.pushes.left.time", time),
        ("scene.pushes.left.duration", PUSH_TIME),
        ("scene.pushes.left.force", force),
        ("scene.pushes.behind.force", (0.0, 0.0, 0.0)),
    )
