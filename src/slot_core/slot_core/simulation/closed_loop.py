"""Controller and simulated robot in one process: the graph in lockstep, without ROS."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np

from slot_core import config
from slot_core.control.controller import Controller, Tick
from slot_core.control.mpc.mpc import DEFAULT_PROFILE, read_mpc
from slot_core.dynamics.scene import Scene, read_scene
from slot_core.dynamics.servo import ServoSettings, read_servo
from slot_core.robot import Array, Robot, read_robot
from slot_core.simulation.clocks import LOCKSTEP_START
from slot_core.simulation.plant import Plant, Reading
from slot_core.simulation.sensors import ImuReading, OdometryReading

PlantMaker = Callable[[Robot, Scene, ServoSettings, np.random.Generator], Plant]


class ClosedLoop:
    """Closed loop of the controller and the simulated robot in a scene.

    Deterministic: equal configuration, scene, gait, velocity [v_x, v_y, yaw rate] and seed give
    bit-equal results, which equal those of the graph in lockstep.
    """

    def __init__(
        self,
        scene: str,
        gait: str,
        velocity: Array | None,
        seed: int,
        profile: str = DEFAULT_PROFILE,
        *,
        make: PlantMaker = Plant,
    ):
        """Build controller and plant; the robot stands in the scene.

        velocity: (3,) m/s, m/s, rad/s, or None for the gait's `cruise`. profile: a file of
        config/mpc, or the default. make: builds the plant.
        Raises ConfigError for a bad argument or configuration.
        """
        robot = read_robot()
        mpc = config.replace(read_mpc(profile), {"acceptance.time_budget": math.inf})
        self.controller = Controller(robot, mpc, lambda: 0.0, gait, velocity)
        self.plant = make(robot, read_scene(scene), read_servo(), np.random.default_rng(seed))

    def run(self, ticks: int) -> Iterator[Tick]:
        """Yield each tick after its command is set; then advance the plant to the next odometry.

        Raises Divergence when the simulation diverges, and RuntimeError when the estimator has no
        estimate for an odometry reading.
        """
        self._read(self.plant.readings_at_rest(LOCKSTEP_START))
        self.plant.start(LOCKSTEP_START)
        for _ in range(ticks):
            tick = self.controller.poll()
            if tick is None:
                raise RuntimeError(
                    f"no estimate at {self.plant.now} ns: the odometry was not usable"
                )
            self.plant.command(tick.command.angle)
            yield tick
            self._read(self.plant.advance_to_odometry())

    def _read(self, readings: Iterable[Reading]) -> None:
        for r in readings:
            if isinstance(r, ImuReading):
                self.controller.estimator.add_imu(r.stamp, r.angular_velocity, r.specific_force)
            elif isinstance(r, OdometryReading):
                self.controller.estimator.add_odometry(
                    r.stamp, r.position, r.quaternion, r.velocity, r.angular_velocity
                )
