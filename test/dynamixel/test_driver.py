"""Driver with the real SDK and emulated servos on a simulated line.

Position PID on the host: terms, limits, anti-windup, missing readings.
"""

import dataclasses
import math

import numpy as np
import pytest

from slot_core import config
from slot_core.dynamixel.bus import CommunicationError, InstructionError
from slot_core.dynamixel.driver import HostPid
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels
from slot_core.dynamixel.settings import HostPidSettings, read_settings
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.faults import Fault
from slot_core.servos.servo_bus import RefusedError

ONE_COUNT = 1.01 * RAD_PER_COUNT
STANDING = (0.1, 0.2, 0.3, 0.4)
PERIOD = 0.01  # s, of the driver's cycles


class DriverRig:
    """Driver and emulated servos; their time passes only in `run`."""

    def __init__(self, changes=(), angles=STANDING):
        settings = config.replace(read_settings(), dict(changes))
        self.legs = EmulatedDynamixels(settings, read_emulator(), angles)
        self.bus, self.time = self.legs.bus, 0.0
        self.connect()

    def connect(self):
        """A driver that knows nothing of another before it."""
        self.driver = self.legs.connect(lambda: self.time)

    def start(self):
        self.driver.configure()
        self.driver.activate()
        return self

    def run(self, duration, goals=None, torques=(0.0,) * 4):
        """Cycles of the driver, between which the servos move; returns all cycles."""
        cycles = []
        for _ in range(round(duration / PERIOD)):
            if goals is not None:
                self.driver.command(goals)
            cycles.append(self.driver.cycle())
            self.legs.advance(PERIOD, torques)
            self.time += PERIOD
        return cycles

    def fault(self, kind, leg="FL", value=0.0):
        self.bus.set_fault(Fault(kind, leg, 0.0, 0.0, value), True)

    def torque(self):
        return [servo.memory["torque_enable"] for servo in self.bus.servos]


@pytest.fixture
def rig():
    return DriverRig()


def test_every_missing_servo_is_named_with_the_error_of_the_sdk(rig):
    rig.fault("silent", "FR")
    rig.fault("wrong_id", "RR", 9)
    with pytest.raises(RefusedError) as caught:
        rig.driver.configure()
    assert [reason.split(":")[0] for reason in caught.value.reasons] == [
        "servo FR (id 4)",
        "servo RR (id 3)",
    ]
    assert all(
        "There is no status packet" in reason for reason in caught.value.reasons
    )
    assert not rig.driver.bus.port.is_open


@pytest.mark.parametrize("control", ["position", "pwm"])
def test_activation_far_from_the_last_goal_is_without_motion(control):
    rig = DriverRig({"control": control})
    for servo in rig.bus.servos:
        servo.memory["goal_position"] = 2900  # left by an earlier run
        servo.memory["goal_pwm"] = 885
    before = rig.legs.angles()
    rig.start()
    assert rig.torque() == [1] * 4
    for _ in range(50):
        rig.legs.advance(0.001)
    # within the count that the encoder rounds down, now and later
    assert np.abs(rig.legs.angles() - before).max() < ONE_COUNT
    rig.run(0.3)
    assert np.abs(rig.legs.angles() - before).max() < 2 * ONE_COUNT


def before_torque_on(rig, act):
    """Let `act` be called with a servo's id before its torque comes on."""
    write_verified = rig.driver.bus.write_verified

    def watched(identity, register, value):
        if register == "torque_enable" and value:
            act(identity)
        write_verified(identity, register, value)

    rig.driver.bus.write_verified = watched


def test_a_servo_lost_during_activation_ends_with_all_torque_off(rig):
    before_torque_on(
        rig, lambda identity: identity == 2 and rig.fault("silent", "RL")
    )
    with pytest.raises(RefusedError, match=r"servo RL"):
        rig.start()
    assert rig.torque() == [0] * 4


def test_gains_and_watchdogs_of_the_configuration_are_set_before_torque_comes_on(
    rig,
):
    gains, found = rig.driver.settings.gains, []
    names = ("bus_watchdog", *(f"position_{name}_gain" for name in "pid"))

    def note(identity):
        servo = next(s for s in rig.bus.servos if s.memory["id"] == identity)
        found.append([servo.memory[name] for name in names])

    before_torque_on(rig, note)
    rig.start()
    assert found == [[5, gains.p, gains.i, gains.d]] * 4  # 100 ms


@pytest.mark.parametrize("control", ["position", "pwm"])
@pytest.mark.parametrize("direction", [(1, 1, 1, 1), (1, -1, 1, -1)])
def test_the_tendons_reach_their_goals(control, direction):
    rig = DriverRig(
        {
            "control": control,
            "joints.direction": direction,
            "joints.zero_deg": [180] * 4,
        }
    )
    rig.start()
    goals = (0.5, 1.0, 1.5, 1.9) if direction[1] == 1 else (0.3, 0.4, 0.5, 0.6)
    rig.run(1.5, goals)
    last = rig.driver.cycle()  # no time has passed since the run
    assert rig.legs.angles() == pytest.approx(goals, abs=3 * RAD_PER_COUNT)
    assert [r.angle for r in last.readings] == pytest.approx(
        rig.legs.angles(), abs=ONE_COUNT
    )


@pytest.mark.parametrize(
    "goals",
    [
        (1, 1, 1),
        (1, 1, math.nan, 1),
        (1, 1, 1, 2.1),
        (-0.1, 1, 1, 1),
        (math.inf, 1, 1, 1),
    ],
)
def test_a_command_with_a_bad_angle_is_rejected_as_a_whole_and_any_with_torque_off(
    rig, goals
):
    rig.start()
    rig.run(1.0, (0.5,) * 4)
    with pytest.raises(ValueError, match=r"expected 4|outside"):
        rig.driver.command(goals)
    rig.run(0.3)
    assert rig.legs.angles() == pytest.approx([0.5] * 4, abs=2 * RAD_PER_COUNT)
    rig.driver.torque_off()
    with pytest.raises(ValueError, match="torque is off"):
        rig.driver.command((1.0,) * 4)


def test_only_a_silent_servo_has_no_reading_and_is_retried_in_its_first_cycle(
    rig,
):
    rig.start()
    rig.run(0.1, STANDING)
    rig.fault("silent", "FL")
    exchanges = rig.driver.bus._failed[5]
    for expected in (1 + rig.driver.settings.bus.retries, 1, 1, 1, 1):
        before = len(exchanges)
        (cycle,) = rig.run(0.01, (0.5,) * 4)
        assert len(exchanges) - before == expected
        missing = [reading is None for reading in cycle.readings]
        assert missing == [True, False, False, False]
    silence = [servo.silence(rig.time) for servo in rig.driver.health]
    assert silence[0] >= 0.05
    assert max(silence[1:]) < 0.02
    # The others have one failure: the fast sync read that lacks the answer of FL.
    assert (
        rig.driver.health[0].error_rate
        > 5 * rig.driver.health[1].error_rate
        > 0
    )
    rig.bus.set_fault(Fault("silent", "FL", 0, 0, 0), False)
    assert rig.run(0.02, (0.5,) * 4)[-1].complete


def test_a_late_answer_is_not_mistaken_for_that_of_another_servo():
    """Answers that the driver has given up come before those to the next instruction."""
    rig, late = DriverRig({"servo.fast_from_firmware": 256}).start(), []
    receive = rig.bus.receive

    def receive_late(data, baud):
        replies = receive(data, baud)
        passed = late + [reply for reply in replies if reply.delay < 0.01]
        late[:] = [reply for reply in replies if reply.delay >= 0.01]
        return passed

    rig.bus.receive = receive_late
    rig.run(0.2)
    rig.fault("late", "RR", 0.04)
    for cycle in rig.run(0.05):
        for reading, angle in zip(cycle.readings, STANDING):
            assert reading is None or abs(reading.angle - angle) < ONE_COUNT
        assert None not in cycle.readings[:3]


def test_a_new_driver_clears_tripped_watchdogs_and_starts_without_motion(rig):
    rig.start()
    rig.run(0.1, (1.5,) * 4)
    rig.driver.close()  # as after a kill: torque on, no instructions
    for _ in range(500):
        rig.legs.advance(0.001)
    stopped = rig.legs.angles()
    rig.connect()
    rig.start()
    rig.run(0.3)
    assert rig.legs.angles() == pytest.approx(stopped, abs=2 * ONE_COUNT)
    assert rig.run(1.0, (0.5,) * 4)[-1].complete
    assert rig.legs.angles() == pytest.approx([0.5] * 4, abs=3 * RAD_PER_COUNT)


def test_errors_lost_torque_and_tripped_watchdogs_are_reported_by_servo(rig):
    rig.start()
    rig.run(0.05, STANDING)
    rig.fault("overheating", "RR", 90)
    rig.run(0.02, STANDING)
    assert rig.torque() == [1, 1, 1, 0]
    assert rig.driver.health[3].hardware_error == 0x04
    rig.bus.servos[1].memory["torque_enable"] = 0
    rig.fault("watchdog", "RL")
    rig.run(0.16, STANDING)  # 16 cycles read every slow register of every servo
    assert [
        line for s in rig.driver.health for line in s.faults(armed=True)
    ] == [
        "servo FR (id 4): torque is off",
        "servo RL (id 2): stopped by its bus watchdog",
        "servo RR (id 3): hardware error: overheating",
        "servo RR (id 3): torque is off",
    ]


def test_torque_off_names_the_servo_that_does_not_confirm(rig):
    rig.start()
    rig.fault("silent", "FL")
    off = rig.driver.torque_off()
    assert off.confirmed == (False, True, True, True)
    assert "servo FL (id 5)" in off.reasons[0]
    # the silent servo executes it without an answer
    assert rig.torque() == [0] * 4


def test_an_error_answer_is_not_read_as_data(rig):
    """A status packet with an error has no data: the SDK's read would return its CRC."""
    rig.driver.configure()
    bus = rig.driver.bus
    with pytest.raises(InstructionError, match="exceeds the limit"):
        bus.write(5, "goal_position", 4095)
    rig.fault("silent", "FL")
    with pytest.raises(
        CommunicationError, match=r"servo FL.*reading led.*no status packet"
    ):
        bus.read(5, "led")


def test_a_rate_that_the_servos_do_not_have_is_refused_with_those_that_they_have():
    with pytest.raises(
        config.ConfigError,
        match=r"bus\.baud = 500000: expected one of 9600, 57600",
    ):
        config.replace(read_settings(), {"bus.baud": 500000})


SETTINGS = HostPidSettings(
    p=2.0,
    i=0.0,
    d=0.0,
    filter_time=0.0,
    duty_limit=1.0,
    duty_rate=1e4,
    blind_time=0.03,
)
H = 0.01
FOUR = np.ones(4)


def pid(**changes):
    return HostPid(dataclasses.replace(SETTINGS, **changes))


def test_duty_is_p_times_the_error_minus_d_times_the_speed_also_when_the_goal_steps():
    loop = pid(d=0.1)
    for goal in (0.3, 0.5):
        duty = loop.step(goal * FOUR, 0.1 * FOUR, 2.0 * FOUR, H)
        assert duty == pytest.approx(2.0 * (goal - 0.1) - 0.1 * 2.0)


def test_the_integral_grows_with_error_and_time():
    loop = pid(p=0.0, i=3.0)
    for _ in range(10):
        duty = loop.step(0.2 * FOUR, 0 * FOUR, 0 * FOUR, H)
    assert duty == pytest.approx(3.0 * 0.2 * 10 * H)


def test_the_integral_is_held_while_the_duty_is_at_its_limit():
    loop = pid(p=1.0, i=5.0, duty_limit=0.5)
    for _ in range(500):
        assert np.all(loop.step(FOUR, 0 * FOUR, 0 * FOUR, H) <= 0.5)
    # The P term alone exceeds the limit, so the integral must not have grown.
    assert loop.integral == pytest.approx(0.0)
    assert np.all(loop.step(0.9 * FOUR, FOUR, 0 * FOUR, H) < 0.0)


def test_the_duty_changes_no_faster_than_its_rate():
    loop, before = pid(p=100.0, duty_rate=20.0), np.zeros(4)
    for goal in (1.0, 1.0, -1.0, -1.0, -1.0):
        duty = loop.step(goal * FOUR, 0 * FOUR, 0 * FOUR, H)
        assert np.all(np.abs(duty - before) <= 20.0 * H + 1e-12)
        before = duty


def test_without_a_reading_the_duty_is_held_for_blind_time_then_zero():
    loop = pid()
    angle = np.zeros(4)
    loop.step(0.2 * FOUR, angle, 0 * FOUR, H)
    angle[1] = np.nan
    duties = [loop.step(0.1 * FOUR, angle, 0 * FOUR, H) for _ in range(5)]
    assert [duty[1] for duty in duties] == pytest.approx(
        [0.4, 0.4, 0.4, 0.0, 0.0]
    )
    assert duties[-1][0] == pytest.approx(0.2)
    assert np.all(np.isfinite(duties))
