"""Controller and simulated robot in one process, without supervisor and ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from slot_core import config
from slot_core.arrays import Array
from slot_core.clock import LOCKSTEP_START, SECOND, to_ns
from slot_core.control.controller import Controller, Tick
from slot_core.control.policies import DEFAULT_POLICY
from slot_core.control.policy import make_policy, policy_class
from slot_core.dynamics.scene import CameraSettings, Scene, read_scene
from slot_core.dynamics.servo import ServoSettings, read_servo
from slot_core.estimation.state_estimator import read_estimator
from slot_core.gait.gait import read_gaits
from slot_core.gait.route import Route
from slot_core.robot import RobotParameters, read_robot
from slot_core.servos.servo_bus import JointReading
from slot_core.simulation.plant import RobotSimulator
from slot_core.simulation.readings import (
    ImageReading,
    ImuReading,
    OdometryReading,
    Reading,
)

if TYPE_CHECKING:
    from slot_core.vision.localizer import MarkerLocalizer

PlantMaker = Callable[
    [RobotParameters, Scene, ServoSettings, np.random.Generator], RobotSimulator
]
SILENCE = SECOND // 2  # ns, longest time without an estimate
# readings of which each may lead to a tick
SENSORS = (ImuReading, ImageReading, OdometryReading)
CHANGEABLE = ("scene", "servo", "robot", "gait", "policy", "estimator")
Settings = TypeVar("Settings")


class _Parts(NamedTuple):
    """The simulated robot, scene and servos."""

    robot: RobotParameters
    scene: Scene
    servo: ServoSettings

    def changed(self, changes: Mapping[str, Any]) -> _Parts:
        """The parts with the changes, by dotted name; raises ConfigError."""
        return _Parts(
            *(
                changed(part, name, changes)
                for name, part in self._asdict().items()
            )
        )


class ClosedLoop:
    """Closed loop of the controller and the simulated robot in a scene.

    Deterministic: equal configuration, scene, gait, velocity [v_x, v_y, yaw rate] and seed give
    bit-equal results.
    """

    def __init__(
        self,
        scene: str,
        gait: str,
        velocity: Array | None,
        seed: int,
        policy: str = DEFAULT_POLICY,
        *,
        changes: Mapping[str, Any] | None = None,
        path: Route | None = None,
        lost_odometry: tuple[float, float] = (0.0, 0.0),
        make: PlantMaker = RobotSimulator,
    ):
        """Build controller and plant; the robot stands in the scene.

        velocity: (3,) m/s, m/s, rad/s, or None for the gait's `cruise`. policy: name or
        file (`policy.py`). changes: values by dotted name below one of `CHANGEABLE`, as
        `scene.payload.mass`; changes of the robot concern the simulated one, not the controller's.
        path: followed instead of the velocity. lost_odometry: begin and duration of a gap, s.
        make: builds the plant. Raises ConfigError for a bad argument or configuration.
        """
        given = changes or {}
        _require_below(CHANGEABLE, given)
        nominal, simulated = read_robot(), read_scene(scene)
        self.gaits = changed(read_gaits(), "gait", given)
        chosen = make_policy(
            policy,
            nominal,
            lambda: 0.0,
            changed(
                policy_class(policy).read_settings(policy), "policy", given
            ),
        )
        self.controller = Controller(
            nominal,
            chosen,
            gait,
            velocity,
            path,
            self.gaits,
            changed(read_estimator(), "estimator", given),
        )
        self._parts = _Parts(
            read_robot(simulated.parameters),
            simulated,
            read_servo(simulated.parameters),
        ).changed(given)
        self._localizer = make_localizer(self._parts.scene.sensors.camera)
        self.plant = make(*self._parts, np.random.default_rng(seed))
        begin, duration = lost_odometry
        self._lost_from = LOCKSTEP_START + to_ns(begin)  # ns
        self._lost_until = self._lost_from + to_ns(duration)

    def change(self, changes: Mapping[str, Any]) -> None:
        """Go on with other values of robot, scene or servo, by dotted name.

        Raises ConfigError for another name, or a value that is not allowed or cannot change
        (`RobotSimulator.change`); nothing has changed then.
        """
        _require_below(_Parts._fields, changes)
        parts = self._parts.changed(changes)
        self.plant.change(*parts)
        self._parts = parts

    def set_policy(self, policy: str) -> None:
        """Go on with another policy (`policy.py`), with its own settings; raises ConfigError."""
        self.controller.policy = make_policy(policy, read_robot(), lambda: 0.0)

    def run(self, ticks: int) -> Iterator[Tick]:
        """Yield each tick after its command is set; then advance the plant to the next one.

        Raises DivergenceError when the simulation diverges, and RuntimeError when the estimator
        gives no estimate for `SILENCE`.
        """
        self.read(self.plant.readings_at_rest(LOCKSTEP_START))
        self.plant.start(LOCKSTEP_START)
        for _ in range(ticks):
            last = self.plant.now
            while (tick := self.controller.poll()) is None:
                if self.plant.now - last > SILENCE:
                    raise RuntimeError(
                        f"no estimate at {self.plant.now} ns: the odometry was not usable"
                    )
                self.read(self.plant.advance_to_reading(*SENSORS))
            self.plant.command(tick.command.angle, tick.command.rate)
            yield tick

    def read(self, readings: Iterable[Reading]) -> None:
        """Give readings to the estimator."""
        for r in readings:
            if isinstance(r, ImuReading):
                self.controller.estimator.add_imu(
                    r.stamp, r.angular_velocity, r.specific_force
                )
            elif isinstance(r, JointReading):
                self.controller.estimator.add_joints(r.stamp, r.angle, r.torque)
            elif isinstance(r, ImageReading) and self._localizer is not None:
                self.controller.estimator.add_odometry(
                    *self._localizer.locate(r.stamp, r.grey).odometry
                )
            elif isinstance(r, OdometryReading) and not (
                self._lost_from <= r.stamp < self._lost_until
            ):
                self.controller.estimator.add_odometry(
                    r.stamp,
                    r.position,
                    r.quaternion,
                    r.velocity,
                    r.angular_velocity,
                )


def _require_below(parts: Sequence[str], changes: Mapping[str, Any]) -> None:
    """Raise ConfigError for a dotted name that begins with none of the parts."""
    for name in changes:
        if name.partition(".")[0] not in parts:
            raise config.ConfigError(
                f"{name}: expected one of {', '.join(parts)}"
            )


def changed(
    settings: Settings, name: str, changes: Mapping[str, Any]
) -> Settings:
    """The settings with the changes, by dotted name, below `name`; raises ConfigError."""
    mine = {
        k.partition(".")[2]: v
        for k, v in changes.items()
        if k.partition(".")[0] == name
    }
    return config.replace(settings, mine, name) if mine else settings


def make_localizer(settings: CameraSettings) -> MarkerLocalizer | None:
    """The localiser of a scene's camera, if it has one; OpenCV is loaded only then."""
    if not settings.enabled:
        return None
    from slot_core.simulation.camera_sensor import marker_localizer  # noqa: PLC0415

    return marker_localizer(settings)
