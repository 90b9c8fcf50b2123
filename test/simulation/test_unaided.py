"""A robot without odometry stands, walks, turns and poses by the gait alone, and says what it lacks."""

import re
from dataclasses import replace

import numpy as np
import pytest

from slot_core.robot import GRAVITY
from slot_core.safety.states import State
from slot_core.simulation.readings import ImuReading
from slot_core.simulation.supervised_loop import SupervisedLoop

UNAIDED = {"estimator.odometry.source": "none"}
NO_IMU = {"scene.sensors.imu.enabled": False}
PLACE = "no watch of motion and tendons: the place is not known"
TILT = "no watch of the tilt: it is not known"


class UnaidedLoop(SupervisedLoop):
    """Supervised loop without odometry that keeps estimated and true poses of the ticks."""

    def __init__(self, gait, velocity=None, hardware="sim", seed=0, **changes):
        super().__init__(
            "flat",
            gait,
            velocity,
            seed,
            "gait_alone",
            hardware=hardware,
            changes=UNAIDED | changes,
        )
        self.seen, self.true = [], []

    def control(self, tick):
        robot = self.plant.robot
        self.seen.append(tick.estimate)
        self.true.append([*robot.rpy, *robot.position])
        super().control(tick)

    def errors(self, ticks):
        """(n, 6) rad, m, of the last ticks."""
        seen = np.array([estimate.state[:6] for estimate in self.seen])
        return (seen - np.array(self.true))[-ticks:]


@pytest.mark.parametrize(
    ("hardware", "seed"), [("sim", 0), ("sim", 1), ("fake_bus", 0)]
)
def test_it_walks_and_knows_tilt_and_height(hardware, seed):
    loop = UnaidedLoop("walk", hardware=hardware, seed=seed)
    *_, last = loop.run(8.0)
    assert last.state is State.WALKING
    assert PLACE in last.warnings
    assert TILT not in last.warnings
    assert loop.plant.robot.position[0] > 0.25  # of 0.05 m/s
    error = loop.errors(120)
    # measured: 0.5 deg, 2 mm
    assert np.degrees(np.abs(error[:, :2])).max() < 1.0
    assert abs(error[:, 5].mean()) < 3e-3


def test_an_imu_in_g_is_named_and_the_robot_does_not_stand():
    loop = UnaidedLoop("walk")
    receive = loop.receive
    loop.receive = lambda reading: receive(
        replace(reading, specific_force=reading.specific_force / GRAVITY)
        if isinstance(reading, ImuReading)
        else reading
    )
    *_, last = loop.run(3.0)
    assert last.state is State.READY
    assert re.match(
        r"imu: specific force [01]\.\d m/s2 of a robot", loop.seen[-1].message
    )


def test_without_an_imu_it_walks_on_ticks_of_the_joints():
    loop = UnaidedLoop("walk", **NO_IMU)
    *_, last = loop.run(8.0)
    assert last.state is State.WALKING
    assert {PLACE, TILT} <= {*last.warnings}
    assert loop.plant.robot.position[0] > 0.25
    apart = np.diff([estimate.stamp for estimate in loop.seen[1:]]) / 1e6
    assert 25.0 < apart.min() <= apart.max() < 40.0  # ms


def test_it_turns_and_the_gyro_counts_the_turn():
    loop = UnaidedLoop("walk", np.array([0.0, 0.0, 0.1]))
    list(loop.run(8.0))
    assert loop.true[-1][2] > 0.3
    # measured: 0.06 of 0.83 rad
    assert abs(loop.errors(1)[0, 2]) < 0.1


@pytest.mark.parametrize("changes", [{}, NO_IMU], ids=["imu", "no imu"])
def test_it_poses(changes):
    """Feet that stick let the gait alone reach 42 mm and a quarter of the roll."""
    loop = UnaidedLoop("stand", **changes)
    list(loop.run(3.0))
    loop.loop.controller.scheduler.set_pose(np.array([0.045, 0.05, 0.0]))
    list(loop.run(3.0))
    assert loop.report.state is State.STANDING
    roll, _, _, _, _, height = loop.true[-1]
    assert height == pytest.approx(0.045, abs=4e-3)
    assert roll > 0.01
    assert np.abs(loop.errors(10)[:, 5]).max() < 5e-3
    if not changes:
        assert np.abs(loop.errors(10)[:, :2]).max() < 0.01
