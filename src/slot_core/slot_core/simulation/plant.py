"""Simulated robot with its servos and sensors on one clock, which advances in whole time steps."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import to_ns, to_seconds
from slot_core.config import ConfigError
from slot_core.dynamics.scene import Push, Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.robot import RobotParameters
from slot_core.safety.rate_limiter import AT_REST, extrapolated
from slot_core.servos.brand import Emulate, EmulatedServos
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.fault_injection import FaultInjection
from slot_core.simulation.make_robot import bring_to_rest, make_robot
from slot_core.simulation.readings import (
    OdometryReading,
    Reading,
    TrueState,
)
from slot_core.simulation.rod_robot import RodRobot
from slot_core.simulation.sensors import (
    ImuSensor,
    OdometrySensor,
    make_camera,
    true_odometry,
)
from slot_core.simulation.timeline import Timeline

if TYPE_CHECKING:
    from slot_core.vision.camera import Camera

CYCLE = 0.01  # s, of the servos, as the driver's bus cycles
UNBOUNDED_RPM = 1e6  # above the speed of any shaft


def ideal_servo(servo: ServoSettings, step: float) -> ServoSettings:
    """Ideal servo that reaches its command within one step (s); raises ConfigError on backlash."""
    if servo.backlash_deg:
        raise ConfigError(
            f"servo.yaml: backlash_deg = {servo.backlash_deg}: emulated servos have none"
        )
    return dataclasses.replace(
        servo, model="ideal", lag=step, ideal_rpm=UNBOUNDED_RPM
    )


class RobotSimulator:
    """Simulated robot, servos and sensors on one clock; yields readings when they are due.

    Odometry, or the camera's image in its place, is due `delay` after its stamp, every other
    reading at its stamp. The robot is frozen in its starting pose until `start` sets the clock.
    Raises ConfigError if the scene has a fault or a push that the robot's model does not support.

    Emulated servos replace model, lag and backlash of `servo.yaml`: in every time step they advance
    by that step, loaded by the tendon torques at its start, and the spools end it at the angles of
    their shafts. They take commands from the bus, `command` only checks; their driver reads them.
    """

    make_robot = staticmethod(make_robot)  # a subclass may have another

    def __init__(
        self,
        robot: RobotParameters,
        scene: Scene,
        servo: ServoSettings,
        rng: np.random.Generator,
        emulate: Emulate | None = None,
    ):
        """`emulate`: makes the emulated servos, if there are any; their torque is off."""
        odometry_rng, imu_rng, trouble_rng, camera_rng = rng.spawn(4)
        driven = (
            servo if emulate is None else ideal_servo(servo, scene.solver.step)
        )
        self.robot = self.make_robot(robot, scene, driven)
        bring_to_rest(self.robot)
        self.emulated: EmulatedServos | None = (
            None
            if emulate is None
            else emulate(self.robot.tendon_angle, scene.supply_voltage)
        )
        self._reads_joints = scene.sensors.joints and emulate is None
        self.timeline = Timeline()
        self.faults = FaultInjection(
            self.robot, scene, self.emulated, self.timeline
        )
        self.held = False  # in its present pose: time runs, but nothing moves
        self._scene = scene
        self._step = to_ns(scene.solver.step)
        self._command = self._goal = self.robot.tendon_angle.copy()  # rad
        self._rate, self._commanded_at = AT_REST, 0  # rad/s; ns
        self._next_cycle = 0  # ns, when the servos' goal follows the command
        self._odometry = OdometrySensor(
            scene.sensors.odometry, odometry_rng, trouble_rng
        )
        self._camera = make_camera(scene.sensors.camera, camera_rng)
        # ns, of the clock's start and of the last delayed reading
        self._started = self._delivered = 0
        self._imu = ImuSensor(scene.sensors.imu, imu_rng)
        self._at_rest: list[Reading] = []
        if scene.pushes:  # raises if the robot supports none
            self.robot.push(np.zeros(3), np.zeros(3))

    @property
    def now(self) -> int:
        """Time of the robot, ns."""
        return self.timeline.now

    @property
    def camera(self) -> Camera | None:
        """Calibration of the camera of the scene, if it has one."""
        return None if self._camera is None else self._camera.camera

    def readings_at_rest(self, stamp: int) -> list[Reading]:
        """Readings of the frozen robot at `stamp` (ns), without delay; equal for equal stamps."""
        if not self._at_rest or stamp != self.now:
            self.timeline.now = stamp
            self._at_rest = [
                *(self._read_imu() if self._scene.sensors.imu.enabled else ()),
                *(self._read_joints() if self._reads_joints else ()),
                self._odometry_or_image(true_odometry(self.robot, stamp), 0.0),
            ]
        return self._at_rest

    def start(self, stamp: int) -> None:
        """Start the clock at `stamp` (ns); the first readings are due one period later."""
        self.timeline.now = self._started = stamp
        sensors = self._scene.sensors
        if sensors.imu.enabled:
            self.timeline.every(sensors.imu.period, self._read_imu)
        if self._reads_joints:
            self.timeline.every(sensors.joint_period, self._read_joints)
        placing = sensors.camera if sensors.camera.enabled else sensors.odometry
        self.timeline.every(placing.period, self._read_odometry)
        for push in self._scene.pushes.values():
            self.push(push)
        self.faults.start()

    def change(
        self, robot: RobotParameters, scene: Scene, servo: ServoSettings
    ) -> None:
        """Go on with another robot, scene or servo; motion, faults and pushes stay.

        Sensors, start, pushes and faults of a scene stay as they were at the start. Raises
        ConfigError for legs or emulated servos that cannot change, and as `RodRobot.change` does.
        """
        if not isinstance(self.robot, RodRobot) or self.emulated is not None:
            raise ConfigError(
                "only simulated rods with simulated servos can change in a run"
            )
        self.robot.change(robot, scene, servo)
        self._scene = scene
        self.faults.change_scene(scene)

    def push(self, push: Push) -> None:
        """Schedule the start, `push.time` from now, and the end of a push; pushes add up."""
        force, moment = np.array(push.force), np.array(push.moment)
        begin = self.now + to_ns(push.time)
        self.timeline.act(begin, partial(self.robot.push, force, moment))
        self.timeline.act(
            begin + to_ns(push.duration),
            partial(self.robot.push, -force, -moment),
        )

    def command(self, angle: Array, rate: Array = AT_REST) -> None:
        """Set the tendon angles (4,), rad, from now on, and their rate (4,), rad/s.

        Every `CYCLE` the servos get the angles of that time, at most for `EXTRAPOLATION_MAX`, then
        they keep them. Raises ValueError for another shape, or a value not finite or out of range.
        """
        self._command = self._goal = self.robot.checked(angle)
        self._rate, self._commanded_at = rate, self.now
        self._next_cycle = self.now + to_ns(CYCLE)

    def advance(self, until: int) -> Iterator[Reading]:
        """Advance to `until` (ns) and yield each reading when it is due."""
        while self.timeline.next_due <= until:
            due, _, action = self.timeline.pop()
            self._simulate(due)
            yield from action()
        self._simulate(until)

    def advance_to_reading(self, *kinds: type) -> Iterator[Reading]:
        """Advance until a reading of one of these kinds is due, which is the last one yielded."""
        while True:
            for reading in self.advance(self.timeline.next_due):
                yield reading
                if isinstance(reading, kinds):
                    return

    def _simulate(self, until: int) -> None:
        """Advance in whole time steps; the periods of `config/scene` are multiples of the step."""
        while (steps := (until - self.now) // self._step) > 0:
            if self.now >= self._next_cycle:
                angle = extrapolated(
                    self._command,
                    self._rate,
                    to_seconds(self.now - self._commanded_at),
                )
                self._goal = np.clip(
                    angle, 0.0, self.robot.parameters.tendon.angle_max
                )
                self._next_cycle = self.now + to_ns(CYCLE)
            steps = min(steps, -((self.now - self._next_cycle) // self._step))
            if not self.held:
                self._advance_robot(steps)
            self.timeline.now += steps * self._step

    def _advance_robot(self, steps: int) -> None:
        if self.emulated is None:
            self.robot.advance(steps, self._goal)
            return
        step, most = (
            self._scene.solver.step,
            self.robot.parameters.tendon.angle_max,
        )
        for _ in range(steps):
            self.robot.advance(
                1,
                np.clip(
                    self.emulated.advance(step, self.robot.servo_torque),
                    0.0,
                    most,
                ),
            )

    def _read_imu(self) -> list[Reading]:
        return [self._imu.sample(self.robot, self.now)]

    def _read_joints(self) -> list[Reading]:
        return [
            JointReading(
                self.now,
                self.robot.tendon_angle,
                self.robot.tendon_rate,
                self.robot.servo_torque,
            )
        ]

    def _read_odometry(self) -> list[Reading]:
        """Return the ground truth now; schedule odometry or image after its delay, in order."""
        truth = true_odometry(self.robot, self.now)
        reading = self._odometry_or_image(
            truth, to_seconds(self.now - self._started)
        )
        delay = (
            self._odometry.delay()
            if self._camera is None
            else self._camera.delay
        )
        self._delivered = max(self._delivered, self.now + to_ns(delay))
        self.timeline.schedule(self._delivered, lambda: [reading])
        if not self._scene.sensors.truth:
            return []
        r = self.robot
        return [
            TrueState(
                self.now, truth, r.tension, r.ground_force, r.nodes, r.directors
            )
        ]

    def _odometry_or_image(
        self, truth: OdometryReading, since: float
    ) -> Reading:
        """Odometry, or the image in its place, `since` the start (s)."""
        if self._camera is not None:
            return self._camera.sample(self.robot, self.now)
        return self._odometry.sample(truth, since)
