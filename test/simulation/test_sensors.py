"""Sensors against the simulated truth: mean and standard deviation of noise, frames, gravity."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import GRAVITY, read_robot
from slot_core.simulation.rod_robot import RodRobot
from slot_core.simulation.sensors import (
    ImuSensor,
    OdometrySensor,
    true_odometry,
)

SCENE = read_scene("flat")
COUNT = 4000
# For COUNT samples the mean is within 4 sigma / sqrt(COUNT), the standard deviation within the
# share 4 / sqrt(2 COUNT).
MEAN, SPREAD = 4 / np.sqrt(COUNT), 4 / np.sqrt(2 * COUNT)


@pytest.fixture(scope="module")
def standing():
    return RodRobot(read_robot(), SCENE, read_servo())


@pytest.fixture(scope="module")
def flying():
    """Robot tumbling in flight at a height of 2 m, with undeformed legs."""
    changes = {
        "start.height": 2.0,
        "start.settle": 0.0,
        "start.tendon_angle_deg": 0.0,
    }
    sim = RodRobot(read_robot(), config.replace(SCENE, changes), read_servo())
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 1.2]).as_matrix()
    sim.state.rotation[:] = turn
    sim.set_motion(np.array([0.4, -0.3, 0.2]), np.array([0.5, 1.0, -0.7]))
    return sim


@pytest.fixture
def truth(standing):
    return true_odometry(standing, 0)


def check_noise(samples, truth, sigma):
    error = np.array(samples) - truth
    assert np.all(np.abs(error.mean(0)) < MEAN * sigma)
    assert np.all(np.abs(error.std(0) / sigma - 1) < SPREAD)


def test_odometry_has_the_stated_noise_and_no_bias(flying):
    """Its twist is in base_link."""
    settings, turn = (
        SCENE.sensors.odometry,
        Rotation.from_matrix(flying.rotation).inv(),
    )
    sensor = OdometrySensor(settings, *np.random.default_rng(7).spawn(2))
    readings = [sensor.sample(true_odometry(flying, 5)) for _ in range(COUNT)]
    errors = [
        (Rotation.from_quat(r.quaternion) * turn).as_rotvec() for r in readings
    ]
    check_noise(errors, 0.0, settings.orientation_noise)
    for name, truth, sigma in (
        ("position", flying.position, settings.position_noise),
        ("velocity", turn.apply([0.4, -0.3, 0.2]), settings.velocity_noise),
        ("angular_velocity", [0.5, 1.0, -0.7], settings.rate_noise),
    ):
        check_noise([getattr(r, name) for r in readings], truth, sigma)
    assert readings[0].stamp == 5


def troubled(changes):
    settings = config.replace(SCENE.sensors.odometry, changes)
    return OdometrySensor(settings, *np.random.default_rng(7).spawn(2))


def test_drift_is_a_random_walk_beside_an_unchanged_noise(truth):
    """Over 100 s the yaw walks by 0.1 rad; the spread over n sensors has the error 1 / sqrt(2n)."""
    plain, count, yaws = troubled({}).sample(truth, 0.0), 200, []
    for seed in range(count):
        settings = config.replace(SCENE.sensors.odometry, {"yaw_drift": 0.01})
        trouble = np.random.default_rng(seed)
        sensor = OdometrySensor(
            settings, np.random.default_rng(7).spawn(2)[0], trouble
        )
        np.testing.assert_array_equal(
            sensor.sample(truth, 0.0).position, plain.position
        )
        for since in (30.0, 100.0):
            reading = sensor.sample(truth, since)
        yaws.append(Rotation.from_quat(reading.quaternion).as_euler("ZYX")[0])
    assert np.std(yaws) == pytest.approx(0.1, rel=4 / np.sqrt(2 * count))


@pytest.mark.parametrize(
    ("begin", "expected"),
    [
        (2.0, [(0.0, 0.0), (1.9, 0.0), (2.0, 0.1), (3.0, 0.1)]),
        (0.0, [(0.0, 0.0), (0.033, 0.1)]),  # not at rest
    ],
)
def test_a_jump_displaces_the_odometry_from_its_time_on(truth, begin, expected):
    jumps = {
        "jumps": {
            "once": {"time": begin, "position": [0.1, 0.0, 0.0], "yaw": 0.0}
        }
    }
    with_jump, without = troubled(jumps), troubled({})
    for since, jump in expected:
        a, b = (sensor.sample(truth, since) for sensor in (with_jump, without))
        np.testing.assert_allclose(
            a.position - b.position, [jump, 0, 0], atol=1e-12
        )
        np.testing.assert_allclose(a.quaternion, b.quaternion, atol=1e-12)


def test_odometry_is_lost_in_a_dropout_and_by_its_share_and_late_within_its_jitter(
    truth,
):
    dropouts = {"dropouts": {"gap": {"time": 1.0, "duration": 0.5}}}
    late = {"delay": 0.01, "jitter": 0.02}
    gap, often = troubled(dropouts), troubled({"loss": 0.25} | late)
    lost = [
        not gap.sample(truth, s).quaternion.any()
        for s in (0.0, 0.9, 1.0, 1.4, 1.5)
    ]
    assert lost == [False, False, True, True, False]
    lost = [not often.sample(truth, 1.0).quaternion.any() for _ in range(COUNT)]
    assert np.mean(lost) == pytest.approx(
        0.25, abs=4 * np.sqrt(0.25 * 0.75 / COUNT)
    )
    delays = [often.delay() for _ in range(COUNT)]
    assert min(delays) == 0.0
    assert 0.029 < max(delays) <= 0.03


def test_imu_has_the_stated_noise_and_a_constant_bias(standing):
    settings = SCENE.sensors.imu
    sensor = ImuSensor(settings, np.random.default_rng(3))
    readings = [sensor.sample(standing, 0) for _ in range(COUNT)]
    rates = np.array([r.angular_velocity for r in readings])
    check_noise(
        rates - standing.angular_velocity, sensor.bias, settings.rate_noise
    )
    forces = [r.specific_force for r in readings]
    check_noise(forces, standing.specific_force, settings.acceleration_noise)
    biases = [
        ImuSensor(settings, np.random.default_rng(k)).bias for k in range(COUNT)
    ]
    check_noise(biases, 0.0, settings.rate_bias)


def test_accelerometer_reads_minus_gravity_at_rest_and_in_free_fall_the_legs_reaction(
    standing, flying
):
    """At the torso's centre it is zero except for the reaction of the swinging legs.

    They are 7 % of the mass; 1 rad/s at 0.2 m gives 0.2 m/s^2, of which 7 % act on the torso.
    """
    # After settling the robot still sinks by some um per step.
    np.testing.assert_allclose(
        standing.specific_force, [0, 0, GRAVITY], atol=0.05
    )
    flying.advance(1, np.zeros(4))
    assert np.abs(flying.specific_force).max() < 0.1
