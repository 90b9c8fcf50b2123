"""Sensor streams of simulated walks with the true motion, and what a visual SLAM does to them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from slot_core.arrays import Array
from slot_core.clock import to_ns, to_seconds
from slot_core.dynamics.scene import read_scene
from slot_core.geometry import rpy_of
from slot_core.simulation.closed_loop import ClosedLoop
from slot_core.simulation.plant import RobotSimulator
from slot_core.simulation.readings import ImuReading, OdometryReading, Reading

_SENSORS = read_scene("flat").sensors
PERIOD, IMU_PERIOD = _SENSORS.odometry.period, _SENSORS.imu.period  # s
WARM_UP = 2.0  # s, until the robot walks and the biases are known
Arrival = tuple[int, ImuReading | OdometryReading]


class RecordingPlant(RobotSimulator):
    """A plant that keeps its IMU samples, its odometry and the true state at every IMU sample."""

    def __init__(self, *parts: Any):
        super().__init__(*parts)
        self.readings: list[ImuReading | OdometryReading] = []
        self.truth: list[tuple[int, Array]] = []

    def _read_imu(self) -> list[Reading]:
        sim, readings = self.robot, super()._read_imu()
        rate = sim.rotation @ sim.angular_velocity
        state = [rpy_of(sim.rotation), sim.position, rate, sim.velocity]
        self.truth.append((self.now, np.concatenate(state)))
        self.readings += [r for r in readings if isinstance(r, ImuReading)]
        return readings

    def motion(self) -> tuple[Array, dict[str, float]]:
        """True states (n, 12) after the warm-up; their mean v_x and largest drift to the side."""
        states = np.array(
            [state for _, state in self.truth][round(WARM_UP / IMU_PERIOD) :]
        )
        speed = (states[-1, 3] - states[0, 3]) / (len(states) * IMU_PERIOD)
        return states, {
            "v_x_mm_s": 1e3 * speed,
            "lateral_mm": 1e3 * np.abs(states[:, 4] - states[0, 4]).max(),
        }

    def _odometry_or_image(
        self, truth: OdometryReading, since: float
    ) -> Reading:
        reading = super()._odometry_or_image(truth, since)
        if isinstance(reading, OdometryReading):
            self.readings.append(reading)
        return reading


@dataclass(frozen=True)
class Streams:
    """Readings of the sensors in one walk, and the true motion."""

    readings: list[ImuReading | OdometryReading]
    stamps: NDArray[np.int64]  # (n,) ns, of the true states
    states: Array  # (n, 12), in the order of `Estimate`, yaw unwrapped

    def true_state(self, time: int) -> Array:
        """True state (12,) at a time, ns; linear between two samples of the IMU."""
        after = int(
            np.clip(np.searchsorted(self.stamps, time), 1, len(self.stamps) - 1)
        )
        t0, t1 = self.stamps[after - 1 : after + 1]
        share = (time - t0) / (t1 - t0)
        return (1 - share) * self.states[after - 1] + share * self.states[after]


def walked(
    seed: int, duration: float, changes: Mapping[str, Any] | None = None
) -> RecordingPlant:
    """The plant after a walk of `duration` (s) on the flat floor, changed as in `ClosedLoop`."""
    loop = ClosedLoop(
        "flat", "walk", None, seed, changes=changes, make=RecordingPlant
    )
    for _ in loop.run(round(duration / PERIOD)):
        pass
    assert isinstance(loop.plant, RecordingPlant)
    return loop.plant


def record(seed: int, duration: float) -> Streams:
    """Streams of a walk of `duration` (s) on the flat floor."""
    plant = walked(seed, duration)
    stamps, states = zip(*sorted(plant.truth, key=lambda entry: entry[0]))
    array = np.array(states)
    array[:, 2] = np.unwrap(array[:, 2])
    return Streams(plant.readings, np.array(stamps), array)


@dataclass(frozen=True)
class Slam:
    """Delay of the odometry between camera and estimator, and a gap."""

    delay: float = 0.0  # s, mean
    jitter: float = 0.0  # s, largest deviation of the delay
    # s after the first reading: none in between
    gap: tuple[float, float] = (0.0, 0.0)

    def arrivals(
        self, streams: Streams, rng: np.random.Generator
    ) -> list[Arrival]:
        """The readings with their times of arrival, ns, in that order."""
        start = min(r.stamp for r in streams.readings)
        result: list[Arrival] = []
        for r in streams.readings:
            if isinstance(r, ImuReading):
                result.append((r.stamp, r))
                continue
            since, late = (
                to_seconds(r.stamp - start),
                self.delay + self.jitter * rng.uniform(-1, 1),
            )
            if self.gap[0] < since < self.gap[1]:
                continue
            result.append((r.stamp + to_ns(max(late, 0.0)), r))
        return sorted(  # of one time the sample of the IMU first
            result, key=lambda item: (item[0], type(item[1]) is OdometryReading)
        )
