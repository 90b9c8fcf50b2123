"""Emulated servos against the e-manual and against the simulator's servo, without a port."""

import dataclasses
import math

import dynamixel_sdk as sdk
import pytest

from slot_core import config
from slot_core.dynamixel.emulator.emulated_bus import EmulatedBus, read_emulator
from slot_core.dynamixel.packet import Parser, build, fast_status
from slot_core.dynamixel.settings import joints, read_settings
from slot_core.dynamixel.table import RAD_PER_COUNT, TABLE, Mode
from slot_core.faults import Fault

BAUD = 57600  # factory setting
HALF = math.pi  # rad, middle of the encoder's turn
NO_LOAD = 57.0 * math.tau / 60.0  # rad/s, no-load speed


@pytest.fixture
def bus():
    return EmulatedBus(read_emulator(), (5, 4, 2, 3), (HALF,) * 4)


def send(bus, identity, instruction, parameters=b"", baud=BAUD):
    """(id, error, data) of every answer."""
    answers = bus.receive(build(identity, instruction, parameters), baud)
    packets = [p for reply in answers for p in Parser().feed(reply.data)]
    assert all(p.intact and p.instruction == sdk.INST_STATUS for p in packets)
    return [(p.id, p.parameters[0], p.parameters[1:]) for p in packets]


def field(name, value):
    register = TABLE[name]
    return register.address.to_bytes(2, "little") + register.encode(value)


def region(name):
    """Address and size of a register, as in a read instruction."""
    register = TABLE[name]
    return register.address.to_bytes(2, "little") + register.size.to_bytes(
        2, "little"
    )


def write(bus, name, value, identity=5):
    ((_, error, _),) = send(bus, identity, sdk.INST_WRITE, field(name, value))
    return error


def read(bus, name, identity=5):
    ((_, error, data),) = send(bus, identity, sdk.INST_READ, region(name))
    assert error & ~sdk.ERRBIT_ALERT == 0
    return TABLE[name].decode(data)


def run(bus, time, loads=(0.0,) * 4, step=0.001):
    for _ in range(round(time / step)):
        bus.advance(step, loads)


MODEL = b"\x24\x04\x2d"  # 1060, firmware 45
DONE, UNKNOWN = [(5, 0, b"")], [(5, sdk.ERRNUM_INSTRUCTION, b"")]
NO_ACCESS, WRONG_SIZE = (
    [(5, sdk.ERRNUM_ACCESS, b"")],
    [(5, sdk.ERRNUM_DATA_LENGTH, b"")],
)
GAINS = "position_d_gain"  # D, I and P have adjacent addresses
GOAL = region("goal_position")
# Instructions with their id and parameters, and (id, error, data) of every answer.
EXCHANGES = {
    "ping": [
        (5, sdk.INST_PING, b"", [(5, 0, MODEL)]),
        (
            sdk.BROADCAST_ID,
            sdk.INST_PING,
            b"",
            [(i, 0, MODEL) for i in (2, 3, 4, 5)],
        ),
        (9, sdk.INST_PING, b"", []),
    ],
    "part of a register, an address or an instruction that is not defined": [
        (5, sdk.INST_WRITE, b"\x74\0\1\2", WRONG_SIZE),
        (5, sdk.INST_WRITE, b"\x48\0\1", NO_ACCESS),
        (5, sdk.INST_READ, b"\x48\0\1\0", NO_ACCESS),
        (5, sdk.INST_READ, b"\x95\2\xff\0", NO_ACCESS),
        (5, 0x77, b"", UNKNOWN),
    ],
    "a write of several registers is executed completely or not at all": [
        (5, sdk.INST_WRITE, field(GAINS, 1) + b"\2\0\3\0", DONE),
        (
            5,
            sdk.INST_WRITE,
            field(GAINS, 7) + b"\2\0\xff\xff",
            [(5, sdk.ERRNUM_DATA_RANGE, b"")],
        ),
        (5, sdk.INST_READ, b"\x50\0\6\0", [(5, 0, b"\1\0\2\0\3\0")]),
    ],
    "the status return level selects the instructions answered": [
        (5, sdk.INST_WRITE, field("status_return_level", 1), DONE),
        (5, sdk.INST_WRITE, field("led", 1), []),
        (5, sdk.INST_READ, region("led"), [(5, 0, b"\1")]),
        (5, sdk.INST_WRITE, field("status_return_level", 0), []),
        (5, sdk.INST_READ, region("led"), []),
        (5, sdk.INST_PING, b"", [(5, 0, MODEL)]),
    ],
    "sync instructions address the named servos": [
        (
            sdk.BROADCAST_ID,
            sdk.INST_SYNC_WRITE,
            GOAL + b"\5\xe8\3\0\0\4\xd0\7\0\0",
            [],
        ),
        (
            sdk.BROADCAST_ID,
            sdk.INST_SYNC_READ,
            GOAL + b"\4\5",
            [(4, 0, b"\xd0\7\0\0"), (5, 0, b"\xe8\3\0\0")],
        ),
    ],
}


@pytest.mark.parametrize("exchanges", EXCHANGES.values(), ids=EXCHANGES)
def test_instructions_are_answered_as_in_the_manual(bus, exchanges):
    for identity, instruction, parameters, answers in exchanges:
        assert send(bus, identity, instruction, parameters) == answers


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("goal_position", 3000, 0),
        ("goal_position", 5000, sdk.ERRNUM_DATA_LIMIT),
        ("goal_pwm", -886, sdk.ERRNUM_DATA_RANGE),
        ("goal_velocity", 266, sdk.ERRNUM_DATA_LIMIT),
        ("position_p_gain", 16384, sdk.ERRNUM_DATA_RANGE),
        ("operating_mode", 5, sdk.ERRNUM_DATA_RANGE),
        ("present_position", 1, sdk.ERRNUM_ACCESS),
        ("model_number", 1, sdk.ERRNUM_ACCESS),
    ],
)
def test_a_write_is_rejected_with_the_error_number_of_the_manual(
    bus, name, value, error
):
    before = read(bus, name)
    assert write(bus, name, value) == error
    assert read(bus, name) == (before if error else value)


def test_eeprom_is_locked_while_torque_is_on(bus):
    for torque, error in ((1, sdk.ERRNUM_ACCESS), (0, 0)):
        write(bus, "torque_enable", torque)
        assert write(bus, "return_delay_time", 0) == error


def fast_read(bus, parameters):
    return bus.receive(
        build(sdk.BROADCAST_ID, sdk.INST_FAST_SYNC_READ, parameters), BAUD
    )


def test_fast_sync_read_is_answered_in_one_packet_that_may_not_be_too_long(bus):
    (reply,) = fast_read(bus, region("present_position") + b"\5\3")
    assert reply.data == fast_status(
        [(5, 0, b"\0\x08\0\0"), (3, 0, b"\0\x08\0\0")]
    )
    assert fast_read(bus, b"\x84\0\xff\xff\5\4") == []


def test_servos_after_a_silent_one_in_a_sync_read_do_not_answer(bus):
    bus.set_fault(Fault("silent", "FR", 0, 0, 0), True)  # id 4
    for ids, answered in ((b"\5\4\2\3", [5]), (b"\5\2\3\4", [5, 2, 3])):
        answers = send(
            bus, sdk.BROADCAST_ID, sdk.INST_SYNC_READ, region("led") + ids
        )
        assert [answer[0] for answer in answers] == answered
    (reply,) = fast_read(bus, region("led") + b"\5\4")
    assert len(reply.data) < 8 + 2 * 5  # shorter than its length field says
    assert not list(Parser().feed(reply.data))


@pytest.mark.parametrize(
    ("mode", "goal", "value"),
    [(Mode.POSITION, "goal_position", 4000), (Mode.PWM, "goal_pwm", 885)],
)
def test_watchdog_stops_the_servo_and_rejects_goals_until_cleared(
    bus, mode, goal, value
):
    write(bus, "operating_mode", mode)
    write(bus, "torque_enable", 1)
    write(bus, "bus_watchdog", 5)  # 100 ms
    for _ in range(10):  # every instruction on the bus restarts it
        run(bus, 0.09)
        send(bus, 3, sdk.INST_READ, region("led"))
    write(bus, goal, value)
    run(bus, 0.099)
    assert bus.servos[0].shaft.speed > 0.5 * NO_LOAD
    run(bus, 0.002)
    stopped = bus.servos[0].shaft.angle
    run(bus, 0.5)
    # In PWM mode it coasts: at most no-load speed times the motor's time constant.
    assert bus.servos[0].shaft.angle - stopped < NO_LOAD * 0.011 + RAD_PER_COUNT
    assert read(bus, "bus_watchdog") == -1
    assert write(bus, goal, value) == sdk.ERRNUM_DATA_RANGE
    assert write(bus, "bus_watchdog", 5) == sdk.ERRNUM_DATA_RANGE
    assert write(bus, "bus_watchdog", 0) == 0
    assert write(bus, goal, value) == 0


@pytest.mark.parametrize(
    ("kind", "value", "bit"),
    [
        ("overload", 0.0, 0x20),
        ("overheating", 90.0, 0x04),
        ("undervoltage", 5.0, 0x01),
    ],
)
def test_hardware_errors_switch_torque_off_until_reboot(bus, kind, value, bit):
    write(bus, "shutdown", 53)
    write(bus, "torque_enable", 1)
    fault = Fault(kind, "FL", 0, 0, value)
    bus.set_fault(fault, True)
    run(bus, 0.002)
    assert send(bus, 5, sdk.INST_PING)[0][1] == sdk.ERRBIT_ALERT
    assert (read(bus, "hardware_error_status"), read(bus, "torque_enable")) == (
        bit,
        0,
    )
    assert (
        write(bus, "torque_enable", 1)
        == sdk.ERRBIT_ALERT | sdk.ERRNUM_RESULT_FAIL
    )
    bus.set_fault(fault, False)
    run(bus, 0.002)
    assert read(bus, "hardware_error_status") == bit
    write(bus, "position_p_gain", 100)
    assert send(bus, 5, sdk.INST_REBOOT) == DONE
    assert send(bus, 5, sdk.INST_PING) == []  # it boots
    run(bus, read_emulator().servo.boot_time + 0.002)
    assert read(bus, "position_p_gain") == TABLE["position_p_gain"].initial
    assert write(bus, "torque_enable", 1) == 0


def test_a_stalled_servo_switches_torque_off_by_overload(bus):
    write(bus, "torque_enable", 1)
    write(bus, "goal_position", 4000)
    # 96 % of the stall torque, limit 80 % for 1 s
    run(bus, 1.2, loads=(1.35, 0, 0, 0))
    assert read(bus, "hardware_error_status") == 0x20
    assert read(bus, "torque_enable") == 0


def test_input_voltage_error_switches_torque_off_only_if_set_in_shutdown(bus):
    write(bus, "torque_enable", 1)  # default of Shutdown: without input voltage
    bus.set_fault(Fault("undervoltage", "FL", 0, 0, 5.0), True)
    run(bus, 0.002)
    assert (read(bus, "hardware_error_status"), read(bus, "torque_enable")) == (
        1,
        1,
    )


# e-manual: V, N m at stall, rev/min without load, A at stall
@pytest.mark.parametrize(
    ("voltage", "stall", "rpm", "current"),
    [(9.0, 1.0, 47.0, 1.0), (11.1, 1.4, 57.0, 1.3), (12.0, 1.5, 61.0, 1.4)],
)
def test_speed_stall_torque_and_heat_are_those_of_the_supply_voltage(
    voltage, stall, rpm, current
):
    supplied = config.replace(read_emulator(), {"servo.voltage": voltage})
    bus = EmulatedBus(supplied, (5, 4, 2, 3), (HALF,) * 4)
    write(bus, "operating_mode", Mode.PWM)
    write(bus, "torque_enable", 1)
    no_load = rpm * math.tau / 60.0
    for load in (0.0, 0.5, 1.0):  # share of the stall torque
        run(bus, 0.3, loads=(load * stall, 0, 0, 0))
        speed = pytest.approx((1.0 - load) * no_load, rel=1e-6, abs=1e-6)
        assert bus.servos[0].shaft.speed == speed
        assert read(bus, "present_velocity") == round(
            (1.0 - load) * rpm / 0.229
        )
        assert read(bus, "present_load") == 1000 * load
    assert read(bus, "present_input_voltage") == round(10 * voltage)
    shaft = bus.servos[0].shaft
    shaft.temperature = shaft.settings.room
    shaft.advance(1.0, stall, voltage, 1.0)
    heat = (
        shaft.temperature - shaft.settings.room
    ) * shaft.settings.thermal_time
    # one resistance for three voltages: the e-manual's are 8.5 to 9.0 ohm
    assert heat == pytest.approx(
        shaft.settings.thermal_resistance * voltage * current, rel=0.06
    )


def test_a_bus_is_not_emulated_at_a_voltage_without_figures_of_the_motor():
    supplied = config.replace(read_emulator(), {"servo.voltage": 8.0})
    with pytest.raises(
        config.ConfigError,
        match=r"supply_voltage = 8\.0: outside \[9\.0, 12\.0\] V",
    ):
        EmulatedBus(supplied, (5, 4, 2, 3), (HALF,) * 4)


def test_with_torque_off_the_gear_holds_up_to_its_friction(bus):
    angle = bus.advance(0.0)[0]
    run(bus, 1.0, loads=(0.09, 0, 0, 0))
    assert bus.advance(0.0)[0] == angle
    run(bus, 1.0, loads=(0.5, 0, 0, 0))
    assert bus.advance(0.0)[0] < angle - 1.0


def test_joint_conversions_are_inverse_to_each_other():
    settings = dataclasses.replace(
        read_settings().joints, direction=(1, -1, 1, -1)
    )
    for joint in joints(settings):
        for angle in (0.0, 1.0, 2.029):
            assert joint.tendon(joint.counts(angle)) == pytest.approx(
                angle, abs=RAD_PER_COUNT
            )
        torque = joint.direction * joint.ratio * joint.servo_torque(0.3)
        assert torque == pytest.approx(0.3)
    with pytest.raises(ValueError, match="two servos with one id"):
        joints(dataclasses.replace(settings, ids=(1, 1, 2, 3)))
    with pytest.raises(ValueError, match="not within one turn"):
        joints(
            dataclasses.replace(
                settings, zero_deg=(300.0,) * 4, direction=(1, 1, 1, 1)
            )
        )
