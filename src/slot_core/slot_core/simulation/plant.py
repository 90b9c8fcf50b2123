"""Simulated robot with its sensors on one clock, which advances in whole time steps."""

from __future__ import annotations

import dataclasses
import heapq
import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from slot_core.clock import to_ns, to_seconds
from slot_core.config import ConfigError
from slot_core.dynamics.scene import CameraSettings, Push, Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamics.simulated_robot import SimulatedRobot
from slot_core.faults import (
    BROKEN,
    BUS_KINDS,
    NAN,
    SLACK,
    Fault,
    legs_of,
    require_simulated_legs,
)
from slot_core.joint_reading import JointReading
from slot_core.paper.paper_robot import PaperRobot
from slot_core.robot import LEGS, Array, RobotParameters
from slot_core.safety.rate_limiter import AT_REST, extrapolated
from slot_core.safety.watchdog import ServoHealth
from slot_core.servos.brand import Emulate, EmulatedServos
from slot_core.simulation.kernel_robot import KernelRobot
from slot_core.simulation.rest import bring_to_rest
from slot_core.simulation.rod_robot import RodRobot
from slot_core.simulation.sensors import (
    ImageReading,
    ImuReading,
    ImuSensor,
    OdometryReading,
    OdometrySensor,
    true_odometry,
)
from slot_core.simulation.tabulated_robot import TabulatedRobot

CYCLE = 0.01  # s, of the servos, as the driver's bus cycles
UNBOUNDED_RPM = 1e6  # above the speed of any shaft

if TYPE_CHECKING:
    from slot_core.simulation.camera_sensor import CameraSensor
    from slot_core.vision.camera import Camera


@dataclass(frozen=True)
class TrueState:
    """Ground truth at `stamp` (ns): exact odometry, tension, ground force and shape of the legs."""

    stamp: int
    odometry: OdometryReading
    tension: Array  # (4,) N
    ground_force: Array  # (4, 3) N in odom
    nodes: Array  # (4, N, 3) m in odom
    directors: (
        Array  # (4, N-1, 3) along the width of the segments, in odom; (4, 0, 3): none
    )


@dataclass(frozen=True)
class StampedHealth:
    """Health of the servos at `stamp` (ns), on which the supervisor steps; None: not reported."""

    stamp: int
    health: ServoHealth | None


Reading = (
    OdometryReading
    | ImageReading
    | ImuReading
    | JointReading
    | TrueState
    | StampedHealth
)


@dataclass(frozen=True, order=True)
class _Event:
    """Action due at `due` (ns); actions of one instant run in the order of `number`."""

    due: int
    number: int
    action: Callable[[], list[Reading]] = field(compare=False)


def make_camera(
    settings: CameraSettings, rng: np.random.Generator
) -> CameraSensor | None:
    """The camera of a scene, if it has one; OpenCV is loaded only then."""
    if not settings.enabled:
        return None
    from slot_core.simulation.camera_sensor import CameraSensor  # noqa: PLC0415

    return CameraSensor(settings, rng)


MODELS: dict[str, type[SimulatedRobot]] = {
    "spatial": RodRobot,
    "map": TabulatedRobot,
    "paper": PaperRobot,
}
ROBOT_WITH_FAULT = {SLACK: KernelRobot, BROKEN: KernelRobot, NAN: RodRobot}


def make_robot(
    robot: RobotParameters, scene: Scene, servo: ServoSettings
) -> SimulatedRobot:
    """Simulated robot with the model of the legs `scene.solver.legs`, settled at its start.

    Raises ConfigError for legs that relax of another model than `spatial`.
    """
    if robot.leg.relaxes and scene.solver.legs != "spatial":
        raise ConfigError(
            f"leg.relaxation_share = {list(robot.leg.relaxation_share)}: legs of the model"
            f" {scene.solver.legs!r} cannot relax; those of 'spatial' can"
        )
    return MODELS[scene.solver.legs](robot, scene, servo)


def ideal_servo(servo: ServoSettings, step: float) -> ServoSettings:
    """Ideal servo that reaches its command within one step (s); raises ConfigError on backlash."""
    if servo.backlash_deg:
        raise ConfigError(
            f"servo.yaml: backlash_deg = {servo.backlash_deg}: emulated servos have none"
        )
    return dataclasses.replace(servo, model="ideal", lag=step, ideal_rpm=UNBOUNDED_RPM)


class RobotSimulator:
    """Simulated robot, servos and sensors on one clock; yields readings when they are due.

    Odometry, or the camera's image in its place, is due `delay` after its stamp, every other
    reading at its stamp. The robot is frozen in its starting pose until `start` sets the clock.
    Raises ConfigError if the scene has a fault or a push that the robot's model does not support.

    Emulated servos replace model, lag and backlash of `servo.yaml`: in every time step they advance
    by that step, loaded by the tendon torques at its start, and the spools end it at the angles of
    their shafts. They take commands from the bus, `command` only checks; their driver reads them.
    """

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
        driven = servo if emulate is None else ideal_servo(servo, scene.solver.step)
        self.robot = make_robot(robot, scene, driven)
        bring_to_rest(self.robot)
        self.emulated: EmulatedServos | None = None
        if emulate is not None:
            self.emulated = emulate(self.robot.tendon_angle, scene.supply_voltage)
        self._reads_joints = scene.sensors.joints and emulate is None
        self.now = 0  # ns
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
        self._started = self._delivered = (
            0  # ns, of the clock and of the last delayed reading
        )
        self._imu = ImuSensor(scene.sensors.imu, imu_rng)
        self._at_rest: list[Reading] = []
        self._events: list[_Event] = []
        self._number = itertools.count()
        self._faults: dict[tuple[str, str], Fault] = {}  # by kind and leg
        for fault in scene.faults.values():
            self._require_supported(fault)
        if scene.pushes:
            self.robot.push(
                np.zeros(3), np.zeros(3)
            )  # raises if the robot supports none

    @property
    def camera(self) -> Camera | None:
        """Calibration of the camera of the scene, if it has one."""
        return None if self._camera is None else self._camera.camera

    def readings_at_rest(self, stamp: int) -> list[Reading]:
        """Readings of the frozen robot at `stamp` (ns), without delay; equal for equal stamps."""
        if not self._at_rest or stamp != self.now:
            self.now = stamp
            sensors = self._scene.sensors
            imu = self._read_imu() if sensors.imu.enabled else []
            joints = self._read_joints() if self._reads_joints else []
            self._at_rest = [*imu, *joints, self._odometry_or_image(self._truth(), 0.0)]
        return self._at_rest

    def start(self, stamp: int) -> None:
        """Start the clock at `stamp` (ns); the first readings are due one period later."""
        self.now = self._started = stamp
        sensors = self._scene.sensors
        if sensors.imu.enabled:
            self.every(sensors.imu.period, self._read_imu)
        if self._reads_joints:
            self.every(sensors.joint_period, self._read_joints)
        placing = sensors.camera if sensors.camera.enabled else sensors.odometry
        self.every(placing.period, self._read_odometry)
        for push in self._scene.pushes.values():
            self.push(push)
        for present in self._faults.values():
            self._schedule_end(present)
        for fault in self._scene.faults.values():
            self._schedule_action(
                self.now + to_ns(fault.time), partial(self.inject, fault)
            )

    def inject(self, fault: Fault) -> None:
        """Start a fault now, whatever its `time`; it replaces one of its kind at that leg.

        Its duration runs on the robot's clock. Raises ConfigError if the robot does not support it.
        """
        self._require_supported(fault)
        for leg in fault.legs:
            self._faults[fault.kind, leg] = fault
            self._set_fault(fault, leg, True)
        if self._events:  # the clock has started
            self._schedule_end(fault)

    def clear(self, kind: str, leg: str) -> None:
        """End the faults of a kind at a leg or at all; raises ValueError if there is none.

        Hardware errors of a servo remain until it is rebooted, a tripped bus watchdog until it is
        cleared.
        """
        active = [
            (kind, each) for each in legs_of(kind, leg) if (kind, each) in self._faults
        ]
        if not active:
            raise ValueError(f"no fault {kind!r} at {leg!r}")
        for key in active:
            self._end(*key)

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
        for leg in LEGS:
            self._update_tendon(leg)

    def push(self, push: Push) -> None:
        """Schedule the start, `push.time` from now, and the end of a push; pushes add up."""
        force, moment = np.array(push.force), np.array(push.moment)
        begin = self.now + to_ns(push.time)
        self._schedule_action(begin, partial(self.robot.push, force, moment))
        self._schedule_action(
            begin + to_ns(push.duration), partial(self.robot.push, -force, -moment)
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
        while self._events[0].due <= until:
            event = heapq.heappop(self._events)
            self._simulate(event.due)
            yield from event.action()
        self._simulate(until)

    def every(self, period: float, read: Callable[[], list[Reading]]) -> None:
        """Schedule a periodic reading (s), first after one period."""
        interval = to_ns(period)

        def action() -> list[Reading]:
            self._schedule(self.now + interval, action)
            return read()

        self._schedule(self.now + interval, action)

    def advance_to_odometry(self) -> Iterator[Reading]:
        """Advance until odometry or an image is due, which is the last reading yielded."""
        return self.advance_to_reading(OdometryReading, ImageReading)

    def advance_to_reading(self, *kinds: type) -> Iterator[Reading]:
        """Advance until a reading of one of these kinds is due, which is the last one yielded."""
        while True:
            for reading in self.advance(self._events[0].due):
                yield reading
                if isinstance(reading, kinds):
                    return

    def _schedule(self, due: int, action: Callable[[], list[Reading]]) -> None:
        heapq.heappush(self._events, _Event(due, next(self._number), action))

    def _schedule_action(self, due: int, act: Callable[[], None]) -> None:
        """Schedule an action without readings."""

        def action() -> list[Reading]:
            act()
            return []

        self._schedule(due, action)

    def _simulate(self, until: int) -> None:
        """Advance in whole time steps; the periods of `config/scene` are multiples of the step."""
        while (steps := (until - self.now) // self._step) > 0:
            if self.now >= self._next_cycle:
                self._goal, self._next_cycle = (
                    self._commanded(),
                    self.now + to_ns(CYCLE),
                )
            steps = min(steps, -((self.now - self._next_cycle) // self._step))
            if not self.held:
                self._advance_robot(steps)
            self.now += steps * self._step

    def _commanded(self) -> Array:
        """Commanded tendon angles (4,), rad, now."""
        age = to_seconds(self.now - self._commanded_at)
        angle = extrapolated(self._command, self._rate, age)
        return np.clip(angle, 0.0, self.robot.parameters.tendon.angle_max)

    def _advance_robot(self, steps: int) -> None:
        if self.emulated is None:
            self.robot.advance(steps, self._goal)
            return
        for _ in range(steps):
            angle = self.emulated.advance(
                self._scene.solver.step, self.robot.servo_torque
            )
            self.robot.advance(
                1, np.clip(angle, 0.0, self.robot.parameters.tendon.angle_max)
            )

    def _read_imu(self) -> list[Reading]:
        return [self._imu.sample(self.robot, self.now)]

    def _read_joints(self) -> list[Reading]:
        sim = self.robot
        return [
            JointReading(self.now, sim.tendon_angle, sim.tendon_rate, sim.servo_torque)
        ]

    def _read_odometry(self) -> list[Reading]:
        """Return the ground truth now; schedule odometry or image after its delay, in order."""
        truth = self._truth()
        reading = self._odometry_or_image(truth, to_seconds(self.now - self._started))
        delay = self._odometry.delay() if self._camera is None else self._camera.delay
        self._delivered = max(self._delivered, self.now + to_ns(delay))
        self._schedule(self._delivered, lambda: [reading])
        return [self._true_state(truth)] if self._scene.sensors.truth else []

    def _truth(self) -> OdometryReading:
        """Odometry without noise, now."""
        return true_odometry(self.robot, self.now)

    def _odometry_or_image(self, truth: OdometryReading, since: float) -> Reading:
        """Odometry, or the image in its place, `since` the start (s)."""
        if self._camera is not None:
            return self._camera.sample(self.robot, self.now)
        return self._odometry.sample(truth, since)

    def _schedule_end(self, fault: Fault) -> None:
        if fault.duration:
            self._schedule_action(
                self.now + to_ns(fault.duration), partial(self._expire, fault)
            )

    def _expire(self, fault: Fault) -> None:
        """End a fault unless it has been cleared or replaced."""
        for leg in fault.legs:
            if self._faults.get((fault.kind, leg)) is fault:
                self._end(fault.kind, leg)

    def _require_supported(self, fault: Fault) -> None:
        """Raise ConfigError if this robot does not support a fault."""
        if fault.kind in BUS_KINDS and self.emulated is not None:
            return
        require_simulated_legs(fault)
        if not isinstance(self.robot, ROBOT_WITH_FAULT[fault.kind]):
            model = self._scene.solver.legs
            raise ConfigError(
                f"fault {fault.kind!r}: legs of the model {model!r} cannot have it"
            )

    def _end(self, kind: str, leg: str) -> None:
        self._set_fault(self._faults.pop((kind, leg)), leg, False)

    def _set_fault(self, fault: Fault, leg: str, on: bool) -> None:
        """Apply a fault that is in `_faults` to a leg, or remove it."""
        if fault.kind in BUS_KINDS:
            assert self.emulated is not None
            act = self.emulated.inject if on else self.emulated.clear
            act(dataclasses.replace(fault, leg=leg))
        elif fault.kind != NAN:
            self._update_tendon(leg)
        elif on:
            assert isinstance(self.robot, RodRobot)
            self.robot.set_tip_to_nan(LEGS.index(leg))

    def _update_tendon(self, leg: str) -> None:
        """Set slack and breakage of a tendon from the scene and the present faults."""
        assert isinstance(self.robot, KernelRobot)
        index, state = LEGS.index(leg), self._scene.tendons
        added = self._faults.get((SLACK, leg))
        slack = state.slack[index] + (added.value if added else 0.0)
        broken = state.broken[index] or (BROKEN, leg) in self._faults
        self.robot.damage_tendon(index, slack, broken)

    def _true_state(self, truth: OdometryReading) -> TrueState:
        sim = self.robot
        return TrueState(
            self.now, truth, sim.tension, sim.ground_force, sim.nodes, sim.directors
        )
