"""Run of a stride on the simulated robot, and its means over settled strides.

The tendon angles are set every `command_period`. The height is held by an offset common to all
legs, corrected once a stride by a share of the mean height error; or the offset is zero.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.config import quantity, text
from slot_core.dynamics.scene import Scene, read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.gait.gait import Stride, Vector3, mean_velocity
from slot_core.refusal import DivergenceError
from slot_core.robot import RobotParameters
from slot_core.simulation.make_robot import make_robot

OUTPUTS = ("v_x", "v_y", "yaw rate", "height", "roll", "pitch")
RISE = 0.053  # m, of the torso per rad of all angles
OFFSET_MAX = math.radians(15.0)  # of the height's correction
# run at the stride's height; a turn finds its own
HELD = ("forward", "lateral")
TIME, X, Y, HEIGHT, ROLL, PITCH, YAW = range(7)  # columns of a track; s, m, rad


@dataclass(frozen=True)
class TuningSettings:
    """How strides are simulated, searched and identified."""

    scene: str = text("scene of config/scene")
    friction: tuple[float, ...] = quantity(
        "friction coefficients of the floors", "", 0.01, 2
    )
    command_period: float = quantity(
        "time between commands of the tendon angles", "s", 1e-3, 0.1
    )
    settling_strides: int = quantity(
        "strides before the first that counts", "", 0, 100
    )
    strides: int = quantity("strides that count", "", 1, 1000)
    height_gain: float = quantity(
        "share of a height error that one stride corrects", "", 0, 1
    )
    evaluations: int = quantity("candidates of a search", "", 1, 1_000_000)
    population: int = quantity("candidates of a generation", "", 4, 10_000)
    step_deg: float = quantity(
        "first standard deviation of the candidates", "deg", 0.01, 90
    )
    coefficient_max_deg: float = quantity(
        "largest coefficient of a pattern", "deg", 1, 360
    )
    scatter_deg: float = quantity(
        "standard deviation of a random start", "deg", 0.01, 90
    )
    speed_scale: Vector3 = quantity(
        "speed that costs 1: v_x, v_y, yaw rate", "SI", 1e-4, 1
    )
    tilt_deg: float = quantity(
        "tilt RMS that costs nothing; largest tilt: twice", "deg", 0, 45
    )
    load: float = quantity(
        "mean torque over stall torque that costs nothing", "", 0, 1
    )
    dip: float = quantity(
        "drop below the stride's height that costs nothing", "m", 0, 0.1
    )
    steering_step_deg: float = quantity(
        "step of a steering coefficient", "deg", 0.01, 20
    )
    steering_rate: float = quantity(
        "yaw rate of the steering that is sought", "rad/s", 1e-3, 0.2
    )
    steering_scale: Vector3 = quantity(
        "size of an error of the steering: v_y, yaw rate, roll", "SI", 1e-4, 1
    )
    steering_damping: float = quantity(
        "weight of a steering coefficient per deg", "", 0, 10
    )


def read_tuning() -> TuningSettings:
    """Read `config/tune.yaml`; raises ConfigError."""
    return config.read(TuningSettings, "tune")


@dataclass(frozen=True)
class Job:
    """A stride on a floor of equal friction."""

    stride: Stride
    friction: float
    velocity: tuple[float, float, float]  # m/s, rad/s, sets the amplitudes
    hold_height: bool = True


class StrideMotion(NamedTuple):
    """Motion over the strides that count; SI units, frame odom."""

    track: Array  # (n, 7) TIME .. YAW
    phase: Array  # (n,)
    force: Array  # (n, 4) N, normal
    velocity: Array  # (n, 2) m/s
    # (6,) `OUTPUTS`, mean over the strides; velocities in base_link
    means: Array
    offset: float  # rad, mean over the strides
    top: float  # m, highest point of the torso
    load: float  # mean torque of the servos over their stall torque

    @property
    def tilt(self) -> Array:
        """Angle of the torso from level (n,), rad, to the second order of roll and pitch."""
        return np.asarray(np.hypot(self.track[:, ROLL], self.track[:, PITCH]))


Outcome = StrideMotion | None  # None: the simulation diverged
RunAll = Callable[[Sequence[Job]], Iterable[Outcome]]


def simulate(
    job: Job, settings: TuningSettings, robot: RobotParameters
) -> Outcome:
    """Run a job; None if the simulation diverges. Raises ConfigError."""
    floor = config.replace(
        read_scene(settings.scene), {"floor.friction": [job.friction] * 4}
    )
    try:
        return _Run(job, settings, robot, floor).motion()
    except DivergenceError:
        return None


class _Run:
    def __init__(
        self,
        job: Job,
        settings: TuningSettings,
        robot: RobotParameters,
        scene: Scene,
    ) -> None:
        self._job, self._settings, self._size = job, settings, robot.torso.size
        servo = read_servo()
        self._stall = float(servo.tendon_stall(scene.supply_voltage))
        self._robot: SimulatedRobot = make_robot(robot, scene, servo)
        self._angle_max = robot.tendon.angle_max
        self._steps = max(1, round(settings.command_period / scene.solver.step))
        self._offset = 0.0  # rad, of all angles
        self._top = 0.0

    def motion(self) -> StrideMotion:
        """Run all strides; keep those that count."""
        first, count = self._settings.settling_strides, self._settings.strides
        rows = [
            self._sample(
                -self._settings.command_period / self._job.stride.period
            )
        ]
        offsets: list[float] = []
        for stride in range(first + count):
            if stride == first:
                # whole strides: from the end of the one before
                rows = rows[-1:]
                self._top = 0.0
            begin = len(rows)
            for phase, angle in self._commands(stride):
                self._robot.advance(self._steps, angle)
                rows.append(self._sample(phase))
            offsets.append(self._offset)
            if self._job.hold_height:
                self._correct(
                    float(np.mean([row[HEIGHT] for row in rows[begin:]]))
                )
        table = np.array(rows)
        track, rest = table[:, :7], table[:, 7:]
        return StrideMotion(
            track=track,
            phase=rest[:, 0],
            force=rest[:, 1:5],
            velocity=rest[:, 5:7],
            means=stride_means(track),
            offset=float(np.mean(offsets[first:])),
            top=self._top,
            load=float(rest[:, 7].mean() / self._stall),
        )

    def _commands(self, number: int) -> list[tuple[float, Array]]:
        """Phases and tendon angles (4,) of the commands that fall into stride `number`."""
        period, dt = self._job.stride.period, self._settings.command_period
        first, last = (
            math.ceil(n * period / dt - 1e-9) for n in (number, number + 1)
        )
        phases = np.clip(
            np.arange(first, last) * dt / period - number, 0.0, 1.0 - 1e-12
        )
        angles = self._job.stride.stride_table(
            phases, np.array(self._job.velocity), self._offset
        )[:, :4]
        return list(zip(phases.tolist(), np.clip(angles, 0.0, self._angle_max)))

    def _sample(self, phase: float) -> list[float]:
        robot, rotation = self._robot, self._robot.rotation
        position, velocity = robot.position, robot.velocity
        self._top = max(
            self._top, float(position[2] + abs(rotation[2]) @ self._size / 2)
        )
        # The sample belongs to the end of the command.
        later = (
            phase + self._settings.command_period / self._job.stride.period
        ) % 1.0
        return [
            robot.time,
            *position,
            *robot.rpy,
            later,
            *robot.ground_force[:, 2],
            *velocity[:2],
            float(robot.servo_torque.mean()),
        ]

    def _correct(self, height: float) -> None:
        """Correct the offset by a stride's mean height (m)."""
        change = (
            self._settings.height_gain
            * (self._job.stride.height - height)
            / RISE
        )
        self._offset = float(
            np.clip(self._offset + change, -OFFSET_MAX, OFFSET_MAX)
        )


def stride_means(track: Array) -> Array:
    """Means (6,) `OUTPUTS` of a track (n, 7) over its whole length."""
    velocity = mean_velocity(track[:, TIME], track[:, [X, Y, YAW]])
    return np.concatenate(
        [velocity, track[1:, [HEIGHT, ROLL, PITCH]].mean(axis=0)]
    )
