"""Odometry with an origin of its own, under the supervisor: the robot walks as with z = 0 the floor."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core.clock import LOCKSTEP_START, to_ns
from slot_core.safety.states import State
from slot_core.simulation.readings import OdometryReading
from slot_core.simulation.supervised_loop import SupervisedLoop

SECONDS = 6.0
LYING = {"scene.start.tendon_angle_deg": 0.0}
REFERENCE = (
    0.27  # m, of the walk with odom's origin on the floor; seeds differ by 4 mm
)


class OriginLoop(SupervisedLoop):
    """Supervised loop whose odometry has another origin, from a time (s) on."""

    origin = 0.0, 0.0, 0.0  # m
    turn = Rotation.identity()
    since = 0.0

    def receive(self, reading):
        begin = LOCKSTEP_START + to_ns(self.since)
        if isinstance(reading, OdometryReading) and reading.stamp >= begin:
            attitude = self.turn * Rotation.from_quat(reading.quaternion)
            reading = replace(
                reading,
                position=self.turn.apply(reading.position) + self.origin,
                quaternion=attitude.as_quat(),
            )
        super().receive(reading)


def walk(seed, height, tilt=(0.0, 0.0, 0.0), *, since=0.0, **options):
    """States passed, way (m) and height (mean of the last stride, m) of a walk."""
    loop = OriginLoop(
        "flat", options.pop("gait", "walk"), None, seed, **options
    )
    loop.origin = np.array([0.3, -0.2, height])
    loop.turn, loop.since = Rotation.from_euler("xyz", np.radians(tilt)), since
    states, heights = [], []
    for report in loop.run(SECONDS):
        states += [report.state] * (states[-1:] != [report.state])
        heights.append(loop.plant.robot.position[2])
    place = loop.plant.robot.position
    return states, float(np.hypot(*place[:2])), np.mean(heights[-32:])


@pytest.mark.parametrize(
    ("height", "tilt", "seed"),
    [
        (-0.5, (0.0, 0.0, 0.0), 0),
        (-0.04, (0.0, 0.0, 0.0), 1),
        (0.02, (0.0, 0.0, 0.0), 2),
        (0.5, (3.0, 0.0, 120.0), 3),
    ],
)
def test_a_robot_that_stands_already_walks(height, tilt, seed):
    states, way, _ = walk(seed, height, tilt)
    assert states == [State.READY, State.STANDING, State.WALKING]
    assert way > 0.9 * REFERENCE


@pytest.mark.parametrize("seed", [0, 1])
def test_a_robot_that_lies_stands_up_and_walks(seed):
    """Where the SLAM was started: at the first pose, as visual SLAMs do."""
    states, way, _ = walk(seed, -0.017, (0.0, 2.0, 0.0), changes=LYING)
    assert states == [State.READY, State.STANDING, State.WALKING]
    assert way > 0.7 * REFERENCE  # it begins to walk a second later


@pytest.mark.parametrize("height", [-0.04, 0.1])
def test_it_stands_at_the_height_of_a_posture(height):
    states, _, above = walk(0, height, gait="stand", changes=LYING)
    assert states == [State.READY, State.STANDING]
    assert above == pytest.approx(0.04, abs=2e-3)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_slam_that_starts_anew_in_mid_walk_stops_it_for_less_than_a_second(
    seed,
):
    states, way, _ = walk(seed, 0.2, (2.0, 2.0, 40.0), since=3.0)
    walking, hold = State.WALKING, State.HOLD
    assert states[2:] == [walking, hold, walking]
    # 0.210 to 0.219 m of six seeds, with the start of the walk again
    assert way > 0.75 * REFERENCE
