"""Packets against the examples of the e-manual, and the parser of a stream of them.

Control table against the one that ships with the SDK.

Port of the driver: refusals, and a pseudo-terminal of emulated servos, which takes real time.

No damaged packet moves a servo, becomes a reading or ends the emulator or the driver.
"""

import time
from pathlib import Path
from types import SimpleNamespace

import dynamixel_easy_sdk
import dynamixel_sdk as sdk
import numpy as np
import pytest
from damage import examples, spliced
from hypothesis import assume, given
from hypothesis import strategies as st

from slot_core import config
from slot_core.dynamixel import packet
from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.driver import FAST, Driver
from slot_core.dynamixel.emulator.emulated_bus import Reply, read_emulator
from slot_core.dynamixel.emulator.emulated_legs import (
    EmulatedDynamixels,
    MemoryPort,
)
from slot_core.dynamixel.emulator.pseudo_terminal import PseudoTerminal
from slot_core.dynamixel.packet import HEADER, Parser, build, status
from slot_core.dynamixel.port import BaudRateError, SerialPort, check_latency
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import TABLE, decode_span, span
from slot_core.faults import Fault
from slot_core.servos.servo_bus import PortError

# ROBOTIS e-manual, Protocol 2.0, the examples of each instruction and its status packets.
EXAMPLES = [
    (build(1, sdk.INST_PING), "FFFFFD00 01 0300 01 194E"),
    (build(sdk.BROADCAST_ID, sdk.INST_PING), "FFFFFD00 FE 0300 01 3142"),
    (status(1, 0, b"\x06\x04\x26"), "FFFFFD00 01 0700 55 00 060426 655D"),
    (status(2, 0, b"\x06\x04\x26"), "FFFFFD00 02 0700 55 00 060426 6F6D"),
    (
        build(1, sdk.INST_READ, b"\x84\0\4\0"),
        "FFFFFD00 01 0700 02 84000400 1D15",
    ),
    (status(1, 0, b"\xa6\0\0\0"), "FFFFFD00 01 0800 55 00 A6000000 8CC0"),
    (
        build(1, sdk.INST_WRITE, b"\x74\0\0\2\0\0"),
        "FFFFFD00 01 0900 03 740000020000 CA89",
    ),
    (status(1, 0), "FFFFFD00 01 0400 55 00 A10C"),
    (
        build(1, sdk.INST_REG_WRITE, b"\x68\0\xc8\0\0\0"),
        "FFFFFD00 01 0900 04 6800C8000000 AE8E",
    ),
    (build(1, sdk.INST_ACTION), "FFFFFD00 01 0300 05 02CE"),
    (build(1, sdk.INST_REBOOT), "FFFFFD00 01 0300 08 2F4E"),
    (
        build(sdk.BROADCAST_ID, sdk.INST_SYNC_READ, b"\x84\0\4\0\1\2"),
        "FFFFFD00 FE 0900 82 840004000102 CEFA",
    ),
    (
        build(
            sdk.BROADCAST_ID,
            sdk.INST_SYNC_WRITE,
            b"\x74\0\4\0\1\x96\0\0\0\2\xaa\0\0\0",
        ),
        "FFFFFD00 FE 1100 83 74000400 0196000000 02AA000000 8287",
    ),
]


@pytest.mark.parametrize(("packet", "example"), EXAMPLES)
def test_packets_equal_the_examples_of_the_manual(packet, example):
    assert packet == bytes.fromhex(example.replace(" ", ""))


def test_parser_finds_packets_with_stuffing_in_noise_fed_in_pieces_of_any_size():
    rng = np.random.default_rng(3)
    sent, stream = [], b""
    for _ in range(200):
        stuffed = rng.choice([0xFF, 0xFD, 0x00], rng.integers(1, 30))
        sent.append(build(int(rng.integers(253)), 3, bytes(stuffed.tolist())))
        noise = rng.integers(0, 0xF0, rng.integers(0, 20), dtype=np.uint8)
        stream += bytes(noise) + sent[-1]
    parser, found = Parser(), []
    while stream:
        size = int(rng.integers(1, 40))
        found += [p for p in parser.feed(stream[:size]) if p.intact]
        stream = stream[size:]
    assert [build(p.id, p.instruction, p.parameters) for p in found] == sent


def test_parser_finds_an_intact_packet_after_a_damaged_one():
    good = build(5, sdk.INST_PING)
    damaged = bytearray(build(5, sdk.INST_WRITE, bytes(20)))
    damaged[5] += 10  # its length now reaches into the next packet
    found = [p for p in Parser().feed(bytes(damaged) + good) if p.intact]
    assert [(p.id, p.instruction) for p in found] == [(5, sdk.INST_PING)]


MODEL = (
    Path(dynamixel_easy_sdk.__file__).parent
    / "control_table"
    / "xl430_w250.model"
)
NAMES = {"secondary(shadow)_id": "secondary_id"}


def test_addresses_and_sizes_equal_those_of_the_sdk():
    rows = (
        MODEL.read_text().split("[control table]")[1].strip().splitlines()[1:]
    )
    assert len(rows) > 45
    for row in rows:
        address, size, name = row.split("\t")
        name = name.strip().lower().replace(" ", "_")
        # additional names of the SDK, and what no driver here uses
        if not (name.endswith(("_write", "_read")) or "indirect" in name):
            register = TABLE[NAMES.get(name, name)]
            assert (register.address, register.size) == (
                int(address),
                int(size),
            ), name


def test_a_span_is_decoded_in_twos_complement_without_registers_partly_covered():
    address, size = span("present_load", "present_position")
    assert (address, size) == (126, 10)
    data = b"\xff\xff" + b"\xfd\xff\xff\xff" + b"\xfd\0\0\0"
    assert decode_span(126, data) == {
        "present_load": -1,
        "present_velocity": -3,
        "present_position": 253,
    }
    assert set(decode_span(127, data[1:-1])) == {"present_velocity"}


@pytest.fixture
def rig(tmp_path):
    """Driver and emulated servos behind a pseudo-terminal."""
    bus = EmulatedDynamixels(read_settings(), read_emulator()).bus
    terminal = PseudoTerminal(bus, tmp_path / "servos")
    # longer than on the robot: a busy machine delays the emulator's thread
    port = SerialPort(terminal.name, 1000000, 1.0)
    driver = Driver(port, read_settings(), lambda: 0.0)
    yield SimpleNamespace(bus=bus, terminal=terminal, driver=driver)
    driver.close()
    terminal.close()


def test_a_baud_rate_that_the_port_does_not_support_is_refused(tmp_path):
    with pytest.raises(BaudRateError, match="4500000 baud is not supported"):
        SerialPort(str(tmp_path / "none"), 4500000, 0.01).open()
    with pytest.raises(PortError, match="none"):
        SerialPort(str(tmp_path / "none"), 1000000, 0.01).open()


def test_a_port_cannot_be_opened_twice(rig):
    rig.driver.configure()
    with pytest.raises(PortError, match="lock"):
        SerialPort(rig.terminal.name, 1000000, 0.01).open()


def test_a_slow_latency_timer_is_refused_with_the_udev_rule_against_it(
    tmp_path,
):
    timer = tmp_path / "ttyUSB7" / "device" / "latency_timer"
    timer.parent.mkdir(parents=True)
    timer.write_text("16\n")
    with pytest.raises(
        PortError, match=r"16 ms, limit 1 ms.*ATTR\{latency_timer\}=\"1\""
    ):
        check_latency("/dev/ttyUSB7", 1, tmp_path)
    timer.write_text("1\n")
    assert check_latency("/dev/ttyUSB7", 1, tmp_path) == 1
    assert check_latency("/dev/ttyACM0", 1, tmp_path) is None


def wait_for(condition):
    """Wait until a condition holds, on a busy machine too."""
    end = time.monotonic() + 60.0
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_a_released_port_is_in_use_until_the_driver_closes_it(rig):
    rig.driver.configure()
    rig.terminal.release()
    rig.driver.activate()
    assert rig.driver.torque_off().complete
    assert rig.terminal.in_use
    rig.driver.close()
    wait_for(lambda: not rig.terminal.in_use)


def test_a_released_port_that_no_driver_has_opened_is_not_in_use(rig):
    rig.terminal.release()
    wait_for(lambda: not rig.terminal.in_use)


def test_a_driver_can_configure_again_after_a_replug(rig, tmp_path):
    unplugged = Fault("unplugged", "all", 0, 0, 0)
    rig.driver.configure()
    rig.bus.set_fault(unplugged, True)
    link = tmp_path / "servos"
    wait_for(lambda: not link.exists())
    with pytest.raises(PortError):
        rig.driver.cycle()
    rig.driver.close()
    with pytest.raises(PortError, match="servos"):
        rig.driver.configure()
    rig.bus.set_fault(unplugged, False)
    wait_for(link.exists)
    rig.driver.configure()
    rig.driver.activate()
    rig.driver.cycle()
    assert rig.driver.cycle().complete


SDK = sdk.PacketHandler(2.0)
BAUD = 1_000_000
REACTION = 0.01  # s, in which a servo moves if it takes a damaged packet
IDS = read_settings().joints.ids


def written(name, value, *ids):
    """Parameters that write a register, or that of several servos."""
    register, data = TABLE[name], TABLE[name].encode(value)
    address = register.address.to_bytes(2, "little")
    if not ids:
        return address + data
    entries = b"".join(bytes([identity]) + data for identity in ids)
    return address + register.size.to_bytes(2, "little") + entries


ADDRESS, SIZE = span(*FAST)
READ = ADDRESS.to_bytes(2, "little") + SIZE.to_bytes(2, "little") + bytes(IDS)
PACKETS = [  # the driver's, and those with the worst effects: torque off, reboot, action
    build(
        sdk.BROADCAST_ID,
        sdk.INST_SYNC_WRITE,
        written("goal_position", 2800, *IDS),
    ),
    build(
        sdk.BROADCAST_ID, sdk.INST_SYNC_WRITE, written("goal_pwm", 885, *IDS)
    ),
    build(sdk.BROADCAST_ID, sdk.INST_FAST_SYNC_READ, READ),
    build(sdk.BROADCAST_ID, sdk.INST_SYNC_READ, READ),
    build(IDS[0], sdk.INST_WRITE, written("goal_position", 2800)),
    build(IDS[1], sdk.INST_WRITE, written("torque_enable", 0)),
    build(IDS[2], sdk.INST_REG_WRITE, written("goal_position", 1500)),
    build(sdk.BROADCAST_ID, sdk.INST_ACTION),
    build(IDS[3], sdk.INST_READ, b"\x40\0\1\0"),
    build(IDS[3], sdk.INST_REBOOT),
]


def valid(data):
    """Parts of `data` that are packets with a CRC valid by the SDK: at times by chance."""
    starts = [n for n in range(len(data)) if data.startswith(HEADER, n)]
    frames = [
        data[n : n + int.from_bytes(data[n + 5 : n + 7], "little") + 7]
        for n in starts
    ]
    return [
        frame
        for frame in frames
        if len(frame) >= 10
        and len(frame) == int.from_bytes(frame[5:7], "little") + 7
        and SDK.updateCRC(0, list(frame), len(frame) - 2)
        == int.from_bytes(frame[-2:], "little")
    ]


def holding_bus():
    """Four servos that hold their position, torque on."""
    legs = EmulatedDynamixels(read_settings(), read_emulator(), (0.5,) * 4)
    for servo in legs.bus.servos:
        servo.memory["goal_position"] = servo.position()
        servo.memory["torque_enable"] = 1
    for _ in range(200):
        legs.advance(0.001)
    return legs.bus


def registers(bus):
    return [dict(servo.memory._values) for servo in bus.servos]


HOLDING = holding_bus()


@given(st.one_of(*map(spliced, PACKETS)))
@examples(1500)
def test_no_damaged_packet_changes_or_moves_a_servo(data):
    assume(not valid(data))
    angles, before = HOLDING.advance(0.0), registers(HOLDING)
    HOLDING.discard_partial()
    replies = HOLDING.receive(data, BAUD)
    answers = [p for reply in replies for p in packet.Parser().feed(reply.data)]
    assert all(p.parameters[0] & 0x7F == packet.sdk.ERRNUM_CRC for p in answers)
    assert registers(HOLDING) == before
    np.testing.assert_array_equal(HOLDING.advance(REACTION), angles)


LINE = SimpleNamespace(
    unplugged=False, receive=lambda data, baud: [Reply(LINE.answer, 0.0)]
)
ONCE = config.replace(read_settings().bus, {"retries": 0})
HELD = ("present_load", "present_velocity", "present_position")
STUFFED = st.lists(
    st.sampled_from([0, 1, 0xFD, 0xFF]), min_size=SIZE, max_size=SIZE
).map(bytes)


def read(answer, fast):
    """Bytes that the driver takes from the line's answer, by servo."""
    LINE.answer = answer
    driven = Bus(MemoryPort(LINE, BAUD, time.monotonic), ONCE)
    found = driven.sync_read(IDS, *FAST, fast)
    return {
        i: b"".join(TABLE[n].encode(a.values[n]) for n in HELD)
        for i, a in found.items()
    }


@given(st.data(), st.booleans(), st.tuples(*[STUFFED] * len(IDS)))
@examples(1000)
def test_no_damaged_reply_becomes_a_reading(data, fast, readings):
    replies = [(identity, 0, held) for identity, held in zip(IDS, readings)]
    sent = (
        [packet.fast_status(replies)]
        if fast
        else [packet.status(*reply) for reply in replies]
    )
    truth = dict(zip(IDS, readings))
    found = read(b"".join(sent), fast)
    # the SDK unstuffs in place
    lost = not fast and any(HEADER[:3] in held for held in readings)
    assert found == truth or (lost and found.items() <= truth.items())
    which = data.draw(st.integers(0, len(sent) - 1))
    damaged = [
        data.draw(spliced(d)) if n == which else d for n, d in enumerate(sent)
    ]
    assume(all(frame in sent for frame in valid(b"".join(damaged))))
    assert read(b"".join(damaged), fast).items() <= truth.items()
