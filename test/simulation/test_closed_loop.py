"""Closed loop of controller and simulated robot: speed, drift, tilt and height of the walk."""

import math

import numpy as np
import pytest

from benchmarks.locomotion.cases import slow_servos, stiffness
from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene
from slot_core.estimation.estimate import Validity
from slot_core.robot import read_robot
from slot_core.simulation.closed_loop import ClosedLoop

PERIOD = read_scene("flat").sensors.odometry.period  # s


def walk(
    duration, scene="flat", gait="walk", velocity=(0.05, 0.0, 0.0), seed=0, **options
):
    """Positions (n, 3), m, and roll-pitch-yaw (n, 3), rad, at every tick, and the ticks."""
    loop = ClosedLoop(scene, gait, np.array(velocity), seed, **options)
    positions, angles, ticks = [], [], []
    for tick in loop.run(round(duration / PERIOD)):
        positions.append(loop.plant.robot.position)
        angles.append(loop.plant.robot.rpy)
        ticks.append(tick)
    return np.array(positions), np.array(angles), ticks


@pytest.fixture(scope="module")
def minute():
    return walk(60.0)


def after(seconds):
    return slice(round(seconds / PERIOD), None)


def mean_velocity(position, seconds=4.0):
    """(3,) m/s, mean from that time on."""
    late = position[after(seconds)]
    return (late[-1] - late[0]) / (PERIOD * (len(late) - 1))


def test_a_minute_of_walking_is_straight_at_the_commanded_speed_and_height(minute):
    position, rpy, _ = minute
    assert mean_velocity(position)[0] == pytest.approx(0.05, abs=1e-3)
    # measured: 11 mm, 11 deg
    assert np.abs(position[:, 1]).max() < 0.03
    assert np.degrees(np.abs(rpy[:, 2])).max() < 15.0
    assert position[after(4.0), 2].mean() == pytest.approx(0.064, abs=1e-3)


def test_the_torso_of_the_walk_stays_level(minute):
    _, rpy, _ = minute
    tilt = np.degrees(np.arccos(np.cos(rpy[:, 0]) * np.cos(rpy[:, 1])))
    # measured: 4.0 deg RMS, 8.1 deg at most; the supervisor's limit is 28 deg
    assert np.sqrt(np.mean(tilt**2)) < 4.1
    assert tilt.max() < 8.5


def test_every_cycle_is_solved_and_commands_stay_within_their_range(minute):
    _, _, ticks = minute
    assert {tick.plan.status.name for tick in ticks} == {"SOLVED"}
    limit = read_robot().tendon.angle_max
    angles = np.array([tick.command.angle for tick in ticks])
    assert angles.min() >= 0.0
    assert angles.max() <= limit


def test_mean_predicted_normal_forces_sum_to_the_weight(minute):
    """On the mean over many strides."""
    _, _, ticks = minute
    normal = np.array([tick.plan.force[0, :, 2] for tick in ticks[100:]])
    assert normal.sum(axis=1).mean() == pytest.approx(read_robot().weight, rel=0.03)


@pytest.mark.parametrize(
    "velocity",
    [(0.02, 0, 0), (0.06, 0, 0), (-0.04, 0, 0), (0, 0.05, 0), (0.025, -0.025, 0)],
)
def test_robot_walks_at_the_commanded_velocity(velocity):
    position, rpy, _ = walk(15.0, velocity=velocity)
    # the feedback takes some strides to find it; measured: 5 mm/s, 11 deg at the most
    assert mean_velocity(position, 6.0)[:2] == pytest.approx(velocity[:2], abs=6e-3)
    assert np.degrees(np.abs(rpy[:, 2])).max() < 15.0


def test_robot_turns_in_place_at_the_commanded_rate():
    position, rpy, _ = walk(12.0, velocity=(0, 0, 0.1))
    late = rpy[after(5.0), 2]
    rate = (late[-1] - late[0]) / (PERIOD * (len(late) - 1))
    assert rate == pytest.approx(0.1, abs=0.012)
    assert np.linalg.norm(position[:, :2], axis=1).max() < 0.03


# On split friction it turns by 3 deg/s, faster than its steering; on 5 deg its feet slide all the
# time. Measured: 10 and 270 mm aside, 35 mm/s uphill.
@pytest.mark.parametrize(
    ("scene", "slow", "fast", "aside"),
    [
        ("slippery", 0.047, 0.053, 0.03),
        ("split", 0.034, 0.066, 0.4),
        ("slope5", 0.02, 0.05, math.inf),
    ],
)
def test_robot_walks_on_and_stays_upright_on_other_floors(scene, slow, fast, aside):
    position, rpy, _ = walk(15.0, scene)
    assert slow < mean_velocity(position, 6.0)[0] < fast
    assert np.abs(position[:, 1]).max() < aside
    assert np.degrees(np.abs(rpy[:, :2])).max() < 12.0


def test_a_payload_lowers_the_default_less_than_the_gait_alone():
    """By some 6 and 9 mm: the largest tendon angle does not carry more."""
    runs = [
        walk(12.0, "payload", policy=policy) for policy in ("rollout_mpc", "gait_alone")
    ]
    lowered = [abs(position[after(4.0), 2].mean() - 0.064) for position, _, _ in runs]
    assert lowered[1] > 5e-3
    assert lowered[0] < 0.7 * lowered[1]


def test_standing_robot_does_not_drift():
    position, rpy, _ = walk(10.0, gait="stand", velocity=(0, 0, 0))
    late = position[after(3.0)]
    assert np.ptp(late[:, :2], axis=0).max() < 1e-3
    assert late[:, 2].mean() == pytest.approx(0.040, abs=5e-4)
    assert late[:, 2] == pytest.approx(0.040, abs=1.5e-3)
    assert np.degrees(np.abs(rpy[after(3.0)])).max() < 0.5


def test_a_payload_off_the_centre_is_carried_at_the_commanded_height_and_level():
    """The default against the MPC on forces, under which it sinks by 7 mm."""
    load = {"scene.payload.mass": 0.3, "scene.payload.place": (0.04, 0.03, 0.03)}
    held = {}
    for policy in ("rollout_mpc", "force_mpc"):
        position, rpy, _ = walk(
            8.0, gait="stand", velocity=(0, 0, 0), policy=policy, changes=load
        )
        late = after(4.0)
        held[policy] = (
            abs(position[late, 2].mean() - 0.04),
            np.abs(rpy[late, :2].mean(axis=0)),
        )
    assert held["rollout_mpc"][0] < 1e-3
    assert np.degrees(held["rollout_mpc"][1]).max() < 0.3
    assert held["force_mpc"][0] > 5e-3


WRONG_MODELS = {
    "none": {},
    "modulus -20 %": dict(stiffness(0.8)),
    "modulus +20 %": dict(stiffness(1.2)),
    "servos' lag doubled": dict(slow_servos(2.0)),
}


@pytest.mark.parametrize("wrong", WRONG_MODELS)
def test_a_robot_on_its_belly_stands_up_without_a_leap(wrong):
    changes = {"scene.start.tendon_angle_deg": 0.0, **WRONG_MODELS[wrong]}
    position, _, _ = walk(3.0, gait="stand", velocity=(0.0, 0.0, 0.0), changes=changes)
    assert position[:, 2].max() < 0.05
    assert position[after(2.0), 2] == pytest.approx(0.04, abs=2e-3)


def test_estimate_follows_the_truth(minute):
    """The estimate is at the stamp of the odometry, the truth up to 10 ms later."""
    position, rpy, ticks = minute
    states = np.array([tick.estimate.state for tick in ticks])
    drift = np.sqrt(np.mean((states[:, 3:6] - position) ** 2, axis=0))
    # at most 0.15 m/s over the delay of 10 ms are 1.5 mm; the noise of the odometry is 1 mm
    assert drift.max() < 2e-3
    tilt_error = np.sqrt(np.mean((states[:, :2] - rpy[:, :2]) ** 2))
    assert tilt_error < math.radians(1.5)  # up to 3 rad/s over 10 ms


def test_values_by_dotted_name_change_the_simulated_robot_and_the_controller():
    changes = {
        "scene.payload.mass": 0.3,
        "servo.lag": 0.04,
        "robot.leg.young_modulus": 2e7,
        "gait.lead": 0.02,
        "policy.cost.yaw": 0.02,
    }
    loop = ClosedLoop("flat", "stand", np.zeros(3), 0, changes=changes)
    assert loop.plant.robot.scene.payload.mass == 0.3
    assert loop.plant.robot.parameters.leg.young_modulus == 2e7
    with pytest.raises(
        ConfigError, match=r"floor\.friction: expected one of scene, servo, robot"
    ):
        ClosedLoop("flat", "stand", np.zeros(3), 0, changes={"floor.friction": 0.2})
    with pytest.raises(ConfigError, match=r"robot: leg\.mass is not a setting"):
        ClosedLoop("flat", "stand", np.zeros(3), 0, changes={"robot.leg.mass": 0.2})


def test_robot_stands_through_a_gap_of_the_odometry():
    loop = ClosedLoop("flat", "stand", np.zeros(3), 0, lost_odometry=(1.0, 0.3))
    validities, stamps = [], []
    for tick in loop.run(90):
        validities.append(tick.estimate.validity)
        stamps.append(tick.estimate.stamp)
        height = loop.plant.robot.position[2]
    assert Validity.ODOMETRY_LOST in validities
    assert validities[-1] == Validity.VALID
    assert np.diff(stamps).min() > 0
    assert height == pytest.approx(0.040, abs=2e-3)
