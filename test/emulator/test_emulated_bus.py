"""Emulated servos against the e-manual and against the simulator's servo, without a port."""

import dataclasses
import math

import pytest

from slot_core import config
from slot_core.config import ConfigError
from slot_core.dynamixel.emulator.emulated_bus import EmulatedBus, read_emulator
from slot_core.dynamixel.joints import joints
from slot_core.dynamixel.packet import (
    ALERT,
    BROADCAST,
    Error,
    Instruction,
    Parser,
    build,
    fast_status,
)
from slot_core.dynamixel.settings import read_settings
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
    assert all(p.intact and p.instruction == Instruction.STATUS for p in packets)
    return [(p.id, p.parameters[0], p.parameters[1:]) for p in packets]


def field(name, value):
    register = TABLE[name]
    return register.address.to_bytes(2, "little") + register.encode(value)


def region(name):
    """Address and size of a register, as in a read instruction."""
    register = TABLE[name]
    return register.address.to_bytes(2, "little") + register.size.to_bytes(2, "little")


def write(bus, name, value, identity=5):
    ((_, error, _),) = send(bus, identity, Instruction.WRITE, field(name, value))
    return error


def read(bus, name, identity=5):
    ((_, error, data),) = send(bus, identity, Instruction.READ, region(name))
    assert error & ~ALERT == 0
    return TABLE[name].decode(data)


def run(bus, time, loads=(0.0,) * 4, step=0.001):
    for _ in range(round(time / step)):
        bus.advance(step, loads)


def test_ping_returns_model_and_firmware(bus):
    assert send(bus, 5, Instruction.PING) == [(5, 0, b"\x24\x04\x2d")]  # 1060, 45
    assert [answer[0] for answer in send(bus, BROADCAST, Instruction.PING)] == [
        2,
        3,
        4,
        5,
    ]
    assert send(bus, 9, Instruction.PING) == []


def test_servos_at_another_baud_rate_do_not_answer(bus):
    assert send(bus, 5, Instruction.PING, baud=1000000) == []
    assert write(bus, "baud_rate", 3) == 0
    assert send(bus, 5, Instruction.PING) == []
    assert len(send(bus, 5, Instruction.PING, baud=1000000)) == 1


@pytest.mark.parametrize(
    ("name", "value", "error"),
    [
        ("goal_position", 3000, Error.NONE),
        ("goal_position", 5000, Error.DATA_LIMIT),
        ("goal_pwm", -886, Error.DATA_RANGE),
        ("goal_velocity", 266, Error.DATA_LIMIT),
        ("position_p_gain", 16384, Error.DATA_RANGE),
        ("operating_mode", 5, Error.DATA_RANGE),
        ("present_position", 1, Error.ACCESS),
        ("model_number", 1, Error.ACCESS),
    ],
)
def test_a_write_is_rejected_with_the_error_number_of_the_manual(
    bus, name, value, error
):
    before = read(bus, name)
    assert write(bus, name, value) == error
    assert read(bus, name) == (before if error else value)


def test_eeprom_is_locked_while_torque_is_on(bus):
    assert write(bus, "torque_enable", 1) == 0
    assert write(bus, "return_delay_time", 0) == Error.ACCESS
    assert write(bus, "torque_enable", 0) == 0
    assert write(bus, "return_delay_time", 0) == 0


def test_part_of_a_register_and_undefined_addresses_are_rejected(bus):
    assert send(bus, 5, Instruction.WRITE, b"\x74\0\1\2")[0][1] == Error.DATA_LENGTH
    assert send(bus, 5, Instruction.WRITE, b"\x48\0\1")[0][1] == Error.ACCESS
    assert send(bus, 5, Instruction.READ, b"\x48\0\1\0") == [(5, Error.ACCESS, b"")]
    assert send(bus, 5, Instruction.READ, b"\x95\2\xff\0") == [(5, Error.ACCESS, b"")]
    assert send(bus, 5, 0x77) == [(5, Error.INSTRUCTION, b"")]


def test_a_write_of_several_registers_is_executed_completely_or_not_at_all(bus):
    good = field("position_d_gain", 1) + b"\2\0\3\0"  # D, I, P have adjacent addresses
    assert send(bus, 5, Instruction.WRITE, good) == [(5, 0, b"")]
    bad = field("position_d_gain", 7) + b"\2\0\xff\xff"
    assert send(bus, 5, Instruction.WRITE, bad) == [(5, Error.DATA_RANGE, b"")]
    names = ("position_d_gain", "position_i_gain", "position_p_gain")
    assert [read(bus, name) for name in names] == [1, 2, 3]


def test_status_return_level_selects_the_instructions_answered(bus):
    for level, instructions in ((1, {"ping", "read"}), (0, {"ping"})):
        send(bus, 5, Instruction.WRITE, field("status_return_level", level))
        answered = {
            "ping": send(bus, 5, Instruction.PING),
            "read": send(bus, 5, Instruction.READ, region("led")),
            "write": send(bus, 5, Instruction.WRITE, field("led", 1)),
        }
        assert {name for name, answers in answered.items() if answers} == instructions


def test_a_damaged_packet_is_answered_with_the_crc_error_and_not_executed(bus):
    data = bytearray(build(5, Instruction.WRITE, field("led", 1)))
    data[10] ^= 1
    (reply,) = bus.receive(bytes(data), BAUD)
    (packet,) = Parser().feed(reply.data)
    assert packet.parameters[0] == Error.CRC
    assert read(bus, "led") == 0


def test_a_registered_write_is_executed_by_action(bus):
    assert send(bus, 5, Instruction.ACTION) == [(5, Error.INSTRUCTION, b"")]
    assert send(bus, 5, Instruction.REG_WRITE, field("led", 1)) == [(5, 0, b"")]
    assert (read(bus, "led"), read(bus, "registered_instruction")) == (0, 1)
    assert send(bus, BROADCAST, Instruction.ACTION) == []
    assert (read(bus, "led"), read(bus, "registered_instruction")) == (1, 0)


def test_sync_and_bulk_instructions_address_the_named_servos(bus):
    sync = region("goal_position") + b"\5\xe8\3\0\0\4\xd0\7\0\0"
    assert send(bus, BROADCAST, Instruction.SYNC_WRITE, sync) == []
    answers = send(
        bus, BROADCAST, Instruction.SYNC_READ, region("goal_position") + b"\4\5"
    )
    assert answers == [(4, 0, b"\xd0\7\0\0"), (5, 0, b"\xe8\3\0\0")]
    bulk = b"\5\x41\0\1\0\1" + b"\4\x64\0\2\0\x0a\0"
    assert send(bus, BROADCAST, Instruction.BULK_WRITE, bulk) == []
    wanted = b"\5\x41\0\1\0" + b"\4\x64\0\2\0"
    answers = send(bus, BROADCAST, Instruction.BULK_READ, wanted)
    assert answers == [(5, 0, b"\1"), (4, 0, b"\x0a\0")]


def test_fast_sync_read_is_answered_in_one_packet(bus):
    request = build(
        BROADCAST, Instruction.FAST_SYNC_READ, region("present_position") + b"\5\3"
    )
    (reply,) = bus.receive(request, BAUD)
    assert reply.data == fast_status([(5, 0, b"\0\x08\0\0"), (3, 0, b"\0\x08\0\0")])


def test_a_fast_read_longer_than_a_packet_is_not_answered(bus):
    request = b"\x84\0\xff\xff\5\4"
    assert (
        bus.receive(build(BROADCAST, Instruction.FAST_SYNC_READ, request), BAUD) == []
    )


def test_servos_after_a_silent_one_in_a_sync_read_do_not_answer(bus):
    bus.inject(Fault("silent", "FR", 0, 0, 0))  # id 4
    read_led = region("led")
    answers = send(bus, BROADCAST, Instruction.SYNC_READ, read_led + b"\5\4\2\3")
    assert [answer[0] for answer in answers] == [5]
    answers = send(bus, BROADCAST, Instruction.SYNC_READ, read_led + b"\5\2\3\4")
    assert [answer[0] for answer in answers] == [5, 2, 3]
    (reply,) = bus.receive(
        build(BROADCAST, Instruction.FAST_SYNC_READ, read_led + b"\5\4"), BAUD
    )
    assert len(reply.data) < 8 + 2 * 5  # shorter than its length field says
    assert not list(Parser().feed(reply.data))


def test_indirect_data_is_an_alias_of_the_indirect_address(bus):
    for k in range(4):
        address = TABLE[f"indirect_address_{k + 1}"].address.to_bytes(2, "little")
        assert send(bus, 5, Instruction.WRITE, address + bytes([116 + k, 0])) == [
            (5, 0, b"")
        ]
    data = TABLE["indirect_data_1"].address.to_bytes(2, "little")
    assert send(bus, 5, Instruction.WRITE, data + b"\0\4\0\0") == [(5, 0, b"")]
    assert read(bus, "goal_position") == 1024
    assert send(bus, 5, Instruction.WRITE, data + b"\0\4")[0][1] == Error.DATA_LENGTH


def test_reboot_switches_torque_off_and_a_booting_servo_does_not_answer(bus):
    write(bus, "torque_enable", 1)
    write(bus, "position_p_gain", 100)
    assert send(bus, 5, Instruction.REBOOT) == [(5, 0, b"")]
    assert send(bus, 5, Instruction.PING) == []
    run(bus, read_emulator().servo.boot_time + 0.002)
    assert read(bus, "torque_enable") == 0
    assert read(bus, "position_p_gain") == TABLE["position_p_gain"].initial


def test_factory_reset_keeps_the_id_if_asked_and_rejects_a_full_broadcast(bus):
    write(bus, "temperature_limit", 50)
    assert send(bus, BROADCAST, Instruction.FACTORY_RESET, b"\xff") == []
    assert read(bus, "temperature_limit") == 50
    assert send(bus, 5, Instruction.FACTORY_RESET, b"\1") == [(5, 0, b"")]
    run(bus, 0.5)
    assert read(bus, "temperature_limit") == 72
    assert read(bus, "id") == 5


@pytest.mark.parametrize("mode", [Mode.POSITION, Mode.PWM])
def test_watchdog_stops_the_servo_and_rejects_goals_until_cleared(bus, mode):
    write(bus, "operating_mode", mode)
    write(bus, "torque_enable", 1)
    goal, value = (
        ("goal_position", 4000) if mode is Mode.POSITION else ("goal_pwm", 885)
    )
    write(bus, goal, value)
    write(bus, "bus_watchdog", 5)  # 100 ms
    run(bus, 0.099)
    assert bus.servos[0].shaft.speed > 0.5 * NO_LOAD
    run(bus, 0.002)
    stopped = bus.servos[0].shaft.angle
    run(bus, 0.5)
    # In PWM mode it coasts: at most no-load speed times the motor's time constant.
    assert bus.servos[0].shaft.angle - stopped < NO_LOAD * 0.011 + RAD_PER_COUNT
    assert read(bus, "bus_watchdog") == -1
    assert write(bus, goal, value) == Error.DATA_RANGE
    assert write(bus, "bus_watchdog", 5) == Error.DATA_RANGE
    assert write(bus, "bus_watchdog", 0) == 0
    assert write(bus, goal, value) == 0


def test_every_instruction_on_the_bus_restarts_the_watchdog(bus):
    write(bus, "torque_enable", 1)
    write(bus, "bus_watchdog", 5)
    for _ in range(10):
        run(bus, 0.09)
        send(bus, 3, Instruction.READ, region("led"))  # another servo
    assert read(bus, "bus_watchdog") == 5


@pytest.mark.parametrize("kind", ["overload", "overheating", "undervoltage"])
def test_hardware_errors_switch_torque_off_until_reboot(bus, kind):
    write(bus, "shutdown", 53)
    write(bus, "torque_enable", 1)
    value = {"overload": 0.0, "overheating": 90.0, "undervoltage": 5.0}[kind]
    bus.inject(Fault(kind, "FL", 0, 0, value))
    run(bus, 0.002)
    assert send(bus, 5, Instruction.PING)[0][1] == ALERT
    bit = {"overload": 0x20, "overheating": 0x04, "undervoltage": 0x01}[kind]
    assert (read(bus, "hardware_error_status"), read(bus, "torque_enable")) == (bit, 0)
    assert write(bus, "torque_enable", 1) == ALERT | Error.RESULT_FAIL
    bus.clear(Fault(kind, "FL", 0, 0, value))
    run(bus, 0.002)
    assert read(bus, "hardware_error_status") == bit
    send(bus, 5, Instruction.REBOOT)
    run(bus, 0.5)
    assert (read(bus, "hardware_error_status"), write(bus, "torque_enable", 1)) == (
        0,
        0,
    )


def test_a_stalled_servo_switches_torque_off_by_overload(bus):
    write(bus, "torque_enable", 1)
    write(bus, "goal_position", 4000)
    run(bus, 1.2, loads=(1.35, 0, 0, 0))  # 96 % of the stall torque, limit 80 % for 1 s
    assert read(bus, "hardware_error_status") == 0x20
    assert read(bus, "torque_enable") == 0


def test_input_voltage_error_switches_torque_off_only_if_set_in_shutdown(bus):
    write(bus, "torque_enable", 1)  # default of Shutdown: without input voltage
    bus.inject(Fault("undervoltage", "FL", 0, 0, 5.0))
    run(bus, 0.002)
    assert (read(bus, "hardware_error_status"), read(bus, "torque_enable")) == (1, 1)


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
    run(bus, 0.3)
    no_load = rpm * math.tau / 60.0
    assert bus.servos[0].shaft.speed == pytest.approx(no_load, rel=1e-6)
    assert read(bus, "present_velocity") == round(rpm / 0.229)
    assert read(bus, "present_load") == 0
    run(bus, 0.3, loads=(stall / 2, 0, 0, 0))
    assert bus.servos[0].shaft.speed == pytest.approx(no_load / 2, rel=1e-6)
    assert read(bus, "present_load") == 500
    run(bus, 0.3, loads=(stall, 0, 0, 0))
    assert bus.servos[0].shaft.speed == pytest.approx(0.0, abs=1e-6)
    assert read(bus, "present_load") == 1000
    assert read(bus, "present_input_voltage") == round(10 * voltage)
    shaft = bus.servos[0].shaft
    shaft.temperature = shaft.settings.room
    shaft.advance(1.0, stall, voltage, 1.0)
    heat = (shaft.temperature - shaft.settings.room) * shaft.settings.thermal_time
    # one resistance for three voltages: the e-manual's are 8.5 to 9.0 ohm
    expected = shaft.settings.thermal_resistance * voltage * current
    assert heat == pytest.approx(expected, rel=0.06)


def test_a_bus_is_not_emulated_at_a_voltage_without_figures_of_the_motor():
    supplied = config.replace(read_emulator(), {"servo.voltage": 8.0})
    with pytest.raises(
        ConfigError, match=r"supply_voltage = 8\.0: outside \[9\.0, 12\.0\] V"
    ):
        EmulatedBus(supplied, (5, 4, 2, 3), (HALF,) * 4)


def test_with_torque_off_the_gear_holds_up_to_its_friction(bus):
    angle = bus.advance(0.0)[0]
    run(bus, 1.0, loads=(0.09, 0, 0, 0))
    assert bus.advance(0.0)[0] == angle
    run(bus, 1.0, loads=(0.5, 0, 0, 0))
    assert bus.advance(0.0)[0] < angle - 1.0


def test_temperature_follows_the_heat_balance(bus):
    shaft = bus.servos[0].shaft
    s = shaft.settings
    for _ in range(200):
        shaft.advance(0.5, 0.7, 11.1, 0.5)  # at rest at half the stall torque
    warm = s.room + s.thermal_resistance * (0.5 * 11.1) ** 2 / s.resistance
    closed = warm + (s.room - warm) * math.exp(-100.0 / s.thermal_time)
    assert shaft.temperature == pytest.approx(closed, abs=0.1)  # Euler at h/tau = 1/360


def test_joint_conversions_are_inverse_to_each_other():
    settings = dataclasses.replace(read_settings().joints, direction=(1, -1, 1, -1))
    for joint in joints(settings):
        for angle in (0.0, 1.0, 2.029):
            assert joint.tendon(joint.counts(angle)) == pytest.approx(
                angle, abs=RAD_PER_COUNT
            )
        assert joint.tendon_torque(joint.servo_torque(0.3)) == pytest.approx(0.3)
        assert joint.counts(0.0) == round(130 / 360 * 4096)
    with pytest.raises(ValueError, match="two servos with one id"):
        joints(dataclasses.replace(settings, ids=(1, 1, 2, 3)))
    with pytest.raises(ValueError, match="not within one turn"):
        joints(
            dataclasses.replace(settings, zero_deg=(300.0,) * 4, direction=(1, 1, 1, 1))
        )
