"""Error-state filter: a reading after a blind swing, and the biases that it learns."""

import dataclasses

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core.clock import SECOND
from slot_core.estimation.inertial_filter import (
    ImuSamples,
    InertialFilter,
    OdometryMotion,
)
from slot_core.estimation.state_estimator import read_estimator
from slot_core.robot import GRAVITY

SETTINGS = read_estimator()
DOWN = np.array([0.0, 0.0, -GRAVITY])
DT = 0.005  # s
NOISE = SETTINGS.odometry
DEVIATION = [
    NOISE.angle_noise,
    NOISE.position_noise,
    NOISE.velocity_noise,
    NOISE.rate_noise,
]
VARIANCE = np.repeat(DEVIATION, 3) ** 2
# a visual SLAM may know one direction better than another
VARIANCE[6:9] *= [0.25, 1.0, 4.0]


@pytest.mark.parametrize("seed", range(5))
def test_a_reading_after_a_blind_swing_is_followed_to_its_noise(seed):
    """The torso of a walk without IMU, 0.2 s after the reading before: 0.2 rad, 0.3 m/s off."""
    rng = np.random.default_rng(seed)
    level = np.array([0.0, 0.0, 0.0, 1.0])
    blind = InertialFilter(SETTINGS)
    still, moving = np.zeros(3), np.array([0.1, -0.2, 0.05])  # m/s
    blind.restart(OdometryMotion(0, level, still, moving, still, VARIANCE))
    blind.propagate_blind(0.2)
    angles, place, velocity, rate = rng.normal(size=(4, 3)) * [
        [0.2],
        [0.02],
        [0.3],
        [1.0],
    ]
    turn = Rotation.from_rotvec(angles)
    seen = OdometryMotion(0, turn.as_quat(), place, velocity, rate, VARIANCE)
    assert blind.correct(seen)
    state, _ = blind.output()
    wanted = [turn.as_euler("ZYX")[::-1], place, turn.apply(velocity)]
    off = np.abs(state[[0, 1, 2, 3, 4, 5, 9, 10, 11]] - np.concatenate(wanted))
    assert (off < 2.0 * np.repeat(DEVIATION[:3], 3)).all()


def test_a_velocity_that_is_known_along_one_axis_of_base_link_corrects_that_alone():
    """Its variance is in the axes of base_link, here 40 deg from those of odom."""
    turn, blind = Rotation.from_euler("z", 0.7), InertialFilter(SETTINGS)
    resting = OdometryMotion(0, turn.as_quat(), *np.zeros((3, 3)), VARIANCE)
    blind.restart(resting)
    blind.propagate_blind(0.2)
    variance = VARIANCE.copy()
    variance[6:9] = 1e-8, 1e4, 1e4
    sideways = np.array([0.1, 0.1, 0.0])
    seen = dataclasses.replace(resting, velocity=sideways, variance=variance)
    assert blind.correct(seen)
    found = turn.inv().apply(blind.state.velocity)
    assert found == pytest.approx([0.1, 0.0, 0.0], abs=1e-3)


# odom tilted by 20 deg
STEEP = np.array([np.sin(0.35), 0.0, np.cos(0.35)]) * GRAVITY
LARGEST = SETTINGS.imu.acceleration_bias_max


@pytest.mark.parametrize(
    ("shown", "bias"),
    [
        (-DOWN + [0.0, 0.0, 0.4], [0.0, 0.0, 0.4]),
        (-DOWN + [0.0, 0.0, 6.0], [0.0, 0.0, LARGEST]),
        (-DOWN - [0.0, 0.0, 1.6], [0.0, 0.0, -LARGEST]),
        (STEEP, STEEP + DOWN),
    ],
)
def test_a_bias_up_to_the_data_sheets_and_any_tilt_of_odom_are_learned_and_no_more(
    shown, bias
):
    resting = OdometryMotion(
        0, np.array([0, 0, 0, 1.0]), *np.zeros((3, 3)), VARIANCE
    )
    learning = InertialFilter(SETTINGS)
    learning.restart(resting)
    # acts at any time
    sample = ImuSamples.none().followed(0, np.append(np.zeros(3), shown), 1)
    for number in range(200):
        learning.propagate(sample, 0, round(DT * SECOND))
        if number % 7 == 6:
            learning.correct(resting)
    np.testing.assert_allclose(learning.state.bias[1], bias, atol=0.05)
