"""Pushes and faults act on the simulated robot; commands go on at their rate.

Sensors against the simulated truth: mean and standard deviation of noise, frames, gravity.
"""

import numpy as np
import pytest
from rod_robots import plant
from scipy.spatial.transform import Rotation

from slot_core import config
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.robot import GRAVITY, read_robot
from slot_core.safety.states import State
from slot_core.simulation.rod_robot import RodRobot
from slot_core.simulation.sensors import (
    ImuSensor,
    OdometrySensor,
    true_odometry,
)
from slot_core.simulation.supervised_loop import SupervisedLoop

START, MILLISECOND = 7_000_000_000, 1_000_000  # ns
FORCE, MOMENT = [0.0, 4.0, 1.0], [0.1, 0.0, 0.2]
FIRST = {"time": 0.1, "duration": 0.05, "force": FORCE, "moment": MOMENT}
SECOND = {
    "time": 0.12,
    "duration": 0.1,
    "force": [2.0, 0.0, 0.0],
    "moment": [0.0, 0.0, 0.0],
}


def make(name="flat", servo=None, **changes):
    scene = config.replace(read_scene(name), {"start.settle": 0.3} | changes)
    return plant(scene, servo)


@pytest.mark.parametrize("shift", [0.0, 4e-4])
def test_pushes_act_from_their_time_for_their_duration_and_add_up(shift):
    """External force and moment in each millisecond; a begin between two steps shifts no clock."""
    first = FIRST | {"time": 0.1 + shift}
    plant, acting = make(pushes={"first": first, "second": SECOND}), []
    plant.start(START)
    for k in range(1, 301):
        acting.append(plant.robot.model.push.copy())
        list(plant.advance(START + k * MILLISECOND))
        assert plant.now == START + k * MILLISECOND
    expected, begin = np.zeros((300, 6)), 100 + np.ceil(shift).astype(int)
    expected[begin : begin + 50] += [*FORCE, *MOMENT]
    expected[120:220, 0] += 2.0
    np.testing.assert_allclose(acting, expected, atol=1e-15)


def test_a_command_goes_on_at_its_rate_for_a_tenth_of_a_second():
    """The ideal servo shows it: it follows its goal, which moves every 10 ms."""
    quick = {"model": "ideal", "lag": 1e-3, "ideal_rpm": 1000.0}
    plant = make(servo=config.replace(read_servo(), quick))
    plant.start(START)
    begin, rate = plant.robot.tendon_angle, np.array([1.0, -0.5, 0.0, 2.0])
    plant.command(begin, rate)
    for milliseconds, moved in [(9, 0.0), (19, 0.01), (99, 0.09), (300, 0.1)]:
        list(plant.advance(START + milliseconds * MILLISECOND))
        goal = begin + moved * rate
        assert plant.robot.tendon_angle == pytest.approx(goal, abs=1e-5)


LOADS = [{"scene.payload.mass": 2.0}, {"robot.torso.mass": 4.0}]


@pytest.mark.parametrize("hardware", ["sim", "fake_bus"])
@pytest.mark.parametrize("load", LOADS, ids=["payload", "torso"])
def test_a_robot_of_twice_its_weight_settles_before_time_zero_and_ends_in_a_stand(
    load, hardware
):
    """It lies on its belly; after `start.settle` alone it would still bounce."""
    loop = SupervisedLoop(
        "flat", "stand", None, 0, hardware=hardware, changes=load
    )
    assert np.linalg.norm(loop.plant.robot.velocity) < 0.01
    states = [report.state for report in loop.run(4.0)]
    assert states[-1] is State.STANDING
    assert State.HOLD not in states


ICE = {"floor.friction": [0.0] * 4, "floor.torso_friction": 0.0}
RESTLESS = r"start\.settle = 0\.3: after 10 s more the torso still"
UNSUPPORTED = "legs of the model 'paper' do not support pushes"


@pytest.mark.parametrize(
    ("scene", "changes", "message"),
    [
        ("slope5", ICE, RESTLESS),
        (
            "paper",
            {"pushes": {"first": FIRST}, "start.settle": 0.0},
            UNSUPPORTED,
        ),
    ],
)
def test_a_restless_robot_and_a_push_that_its_legs_do_not_support_are_refused(
    scene, changes, message
):
    with pytest.raises(config.ConfigError, match=message):
        make(scene, **changes)


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
