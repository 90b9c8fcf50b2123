"""No damaged packet moves a servo, becomes a reading or ends the emulator or the driver."""

import copy
import time
from types import SimpleNamespace

import numpy as np
from damage import examples, spliced
from dynamixel_sdk import PacketHandler
from hypothesis import assume, given
from hypothesis import strategies as st

from slot_core import config
from slot_core.dynamixel import packet
from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.driver import FAST
from slot_core.dynamixel.emulator.emulated_bus import Reply, read_emulator
from slot_core.dynamixel.emulator.emulated_legs import (
    EmulatedDynamixels,
    MemoryPort,
)
from slot_core.dynamixel.packet import BROADCAST, HEADER, Instruction, build
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import REGISTERS, TABLE, span

SDK = PacketHandler(2.0)
BAUD = 1_000_000
REACTION = 0.01  # s, in which a servo moves if it takes a damaged packet
IDS = read_settings().joints.ids
RANGES = [
    r
    for r in REGISTERS
    if r.writable and r.name != "bus_watchdog" and r.address < 168
]


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
        BROADCAST, Instruction.SYNC_WRITE, written("goal_position", 2800, *IDS)
    ),
    build(BROADCAST, Instruction.SYNC_WRITE, written("goal_pwm", 885, *IDS)),
    build(BROADCAST, Instruction.FAST_SYNC_READ, READ),
    build(BROADCAST, Instruction.SYNC_READ, READ),
    build(IDS[0], Instruction.WRITE, written("goal_position", 2800)),
    build(IDS[1], Instruction.WRITE, written("torque_enable", 0)),
    build(IDS[2], Instruction.REG_WRITE, written("goal_position", 1500)),
    build(BROADCAST, Instruction.ACTION),
    build(IDS[3], Instruction.READ, b"\x40\0\1\0"),
    build(IDS[3], Instruction.REBOOT),
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


def obey(packet):
    """Assert that the servos take a packet and keep their registers in range; then reset them."""
    OBEYING.receive(packet, BAUD)
    OBEYING.advance(0.001)
    for servo in OBEYING.servos:
        assert [
            r.name
            for r in RANGES
            if not r.low <= servo.memory[r.name] <= r.high
        ] == []
    OBEYING.servos = copy.deepcopy(KEPT)


HOLDING, OBEYING = holding_bus(), holding_bus()
KEPT = copy.deepcopy(OBEYING.servos)


@given(st.sampled_from(PACKETS).flatmap(spliced))
@examples(1500)
def test_no_damaged_packet_changes_or_moves_a_servo(data):
    if valid(data):
        return obey(data)
    angles, before = HOLDING.advance(0.0), registers(HOLDING)
    HOLDING.discard_partial()
    replies = HOLDING.receive(data, BAUD)
    answers = [p for reply in replies for p in packet.Parser().feed(reply.data)]
    assert all(p.parameters[0] & 0x7F == packet.Error.CRC for p in answers)
    assert registers(HOLDING) == before
    np.testing.assert_array_equal(HOLDING.advance(REACTION), angles)


@given(
    st.sampled_from([*IDS, BROADCAST]),
    st.sampled_from([*Instruction]) | st.integers(0, 255),
    st.binary(max_size=24)
    | st.builds(
        lambda register, more: register.address.to_bytes(2, "little") + more,
        st.sampled_from(REGISTERS),
        st.binary(max_size=20),
    ),
)
@examples(1000)
def test_no_instruction_leaves_a_register_beyond_its_range(
    identity, instruction, parameters
):
    obey(build(identity, instruction, parameters))


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
