"""The simulated robot on emulated servos: shafts and spools, loads, a walk; without ROS."""

import dataclasses
import math

import numpy as np
import pytest

from slot_core.config import ConfigError
from slot_core.dynamics.scene import read_scene
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import PWM_FULL, RAD_PER_COUNT
from slot_core.faults import Fault
from slot_core.robot import read_robot
from slot_core.servos.registry import read_brand
from slot_core.servos.session import ServoSession
from slot_core.simulation.plant import RobotSimulator, ideal_servo
from slot_core.simulation.supervised_loop import SupervisedLoop

ROBOT = read_robot()
SETTLED = 150  # reports of the supervisor, 3 s: the robot walks at its speed


def make(scene="flat"):
    rng = np.random.default_rng(1)
    return RobotSimulator(
        ROBOT, read_scene(scene), read_servo(), rng, read_brand().emulate
    )


@pytest.fixture
def plant():
    return make()


def run(plant, duration):
    """Advance by a time (s) and return all readings."""
    return list(plant.advance(plant.now + round(duration * 1e9)))


def switch_on(plant, angles):
    """Write goals at tendon angles (4,), rad, and torque on to the registers."""
    for joint, servo, angle in zip(
        plant.emulated.joints, plant.emulated.bus.servos, angles
    ):
        servo.memory["goal_position"] = joint.counts(angle)
        servo.memory["torque_enable"] = 1


def test_servos_start_at_the_settled_tendon_angles_with_torque_off(plant):
    assert plant.emulated.angles() == pytest.approx(plant.robot.tendon_angle, abs=1e-12)
    assert plant.emulated.powered() == ()


def test_spool_angles_equal_shaft_angles_after_every_step(plant):
    plant.start(0)
    switch_on(plant, plant.robot.tendon_angle + np.array([0.3, -0.1, 0.2, 0.1]))
    assert plant.emulated.powered() == ("FL", "FR", "RL", "RR")
    for _ in range(100):
        run(plant, 0.001)
        # rounding of angle + h (command - angle) / h
        assert plant.robot.tendon_angle == pytest.approx(
            plant.emulated.angles(), abs=1e-12
        )


def test_without_torque_tendons_unwind_until_the_friction_of_the_gear_holds_them(plant):
    plant.start(0)
    before = plant.robot.tendon_angle
    run(plant, 2.0)
    assert (plant.robot.tendon_angle < before - 0.05).all()
    friction = (
        read_emulator().servo.shaft.friction * read_settings().joints.servo_per_tendon
    )
    # the gear holds this load and creeps at a slightly larger one
    assert plant.robot.servo_torque.max() < friction * 1.1


def test_joint_readings_come_only_from_the_driver(plant):
    plant.start(0)
    names = {type(reading).__name__ for reading in run(plant, 0.1)}
    assert "OdometryReading" in names
    assert "JointReading" not in names


def test_backlash_is_refused():
    servo = dataclasses.replace(read_servo(), backlash_deg=1.0)
    with pytest.raises(
        ConfigError, match=r"backlash_deg = 1\.0: emulated servos have none"
    ):
        ideal_servo(servo, 0.001)


def test_spool_angles_stay_within_the_range_of_the_tendons(plant):
    plant.start(0)
    low = -math.radians(read_settings().joints.margin_deg) / 2
    switch_on(plant, np.full(4, low))
    run(plant, 1.0)
    assert plant.emulated.angles().max() < 0.0
    assert (plant.robot.tendon_angle >= 0.0).all()


def driver_of(plant):
    """A driver on the plant's clock, with torque on."""
    driver = plant.emulated.connect(lambda: plant.now * 1e-9)
    driver.configure()
    driver.activate()
    return driver


@pytest.mark.parametrize("scene", ["flat", "low_battery"])
def test_servos_measure_the_scenes_voltage_and_the_torque_of_the_tendons(scene):
    plant = make(scene)
    session = ServoSession(driver_of(plant), ROBOT.tendon.angle_max, 0.01)
    plant.start(0)
    for _ in range(50):  # every servo is asked for its voltage once in 16 cycles
        cycle = session.bus.cycle()
        run(plant, 0.01)
    assert session.voltage == pytest.approx(
        [read_scene(scene).supply_voltage] * 4, abs=1e-9
    )
    found = cycle.joints(plant.now, read_servo().tendon_stall(session.voltage))
    # within two counts of the encoder, of which the P gain makes 0.7 % of stall each, and what the
    # friction of the guide holds
    expected, give = plant.robot.servo_torque, ROBOT.tendon.capstan
    assert (
        np.abs(found.torque - expected) < 2 * 0.0071 * 1.45 + (give - 1) * expected
    ).all()


@pytest.mark.parametrize(
    ("kind", "value", "most"),
    [("tendon_broken", 0.0, 0.01), ("tendon_slack", 0.003, 0.4)],
)
def test_driver_measures_the_loss_of_load_of_a_damaged_tendon(plant, kind, value, most):
    """Measured: 0.47 of the stall torque at all servos, then 0 or 0.37 at this one."""
    driver = driver_of(plant)
    plant.start(0)

    def loads(cycles):
        for _ in range(cycles):
            cycle = driver.cycle()
            run(plant, 0.01)
        return np.array([reading.load for reading in cycle.readings])

    before = loads(50)
    plant.faults.inject(Fault(kind, "RL", 0.0, 0.0, value))
    after = loads(50)
    count = 0.0071  # share of the stall torque that the P gain makes of one count of the encoder
    assert np.ptp(before) <= 2 * count
    assert np.argmin(after) == 2
    assert after[2] < most
    assert (
        after[[0, 3]].min() > before.min() + 2 * count
    )  # the torso tilts onto the neighbours of the leg


def walk(hardware):
    """A walk of 10 s: the loop at its end, and the torso's centre (n, 3), m, every 20 ms."""
    loop = SupervisedLoop("flat", "walk", None, 0, hardware=hardware)
    return loop, np.array([loop.plant.robot.position for _ in loop.run(10.0)])


@pytest.fixture(scope="module")
def walks():
    return {hardware: walk(hardware) for hardware in ("sim", "fake_bus")}


def test_the_simulated_servo_is_that_of_the_bus():
    """servo.yaml has the gains of the real servo's position control at the tendon angle.

    Its duty is P/128 of an error in counts, over the full duty; I and D act once a loop period.
    """
    settings, period, found = (
        read_settings(),
        read_emulator().servo.loop_period,
        read_servo(),
    )
    ratio, gains = settings.joints.servo_per_tendon, settings.gains
    duty = ratio / RAD_PER_COUNT / PWM_FULL  # per rad of tendon angle, with gain 1
    assert found.model == "pid"
    assert found.servo_per_tendon == ratio
    assert found.proportional == pytest.approx(gains.p / 128 * duty, rel=1e-4)
    assert found.integral == pytest.approx(gains.i / 65536 * duty / period, rel=1e-4)
    assert found.derivative == pytest.approx(gains.d / 16 * duty * period, rel=1e-4)


def test_the_bus_changes_the_walk_by_a_few_millimetres(walks):
    """The two differ by encoder, counts, bus cycles and driver alone."""
    (_, bus), (_, sim) = walks["fake_bus"], walks["sim"]
    # 6.6 mm, 3 of other seeds; walks of two seeds differ by 4 to 7 mm
    assert np.sqrt(np.mean(np.sum((bus - sim) ** 2, axis=1))) < 8e-3
    distances = [path[-1, 0] - path[SETTLED, 0] for path in (bus, sim)]
    assert distances[0] == pytest.approx(distances[1], abs=7e-3)  # 1 mm/s


def test_ten_seconds_of_walking_neither_overload_nor_heat_a_servo(walks):
    loop, _ = walks["fake_bus"]
    servos = loop.plant.emulated.bus.servos
    assert [servo.memory["hardware_error_status"] for servo in servos] == [0] * 4
    assert (
        max(servo.temperature() for servo in servos)
        < read_emulator().servo.shaft.room + 5.0
    )
    assert [health.error_rate for health in loop.servos.session.bus.health] == [0.0] * 4
