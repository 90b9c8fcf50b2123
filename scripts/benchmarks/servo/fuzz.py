"""Random and mutated packets to the emulated servos, and to the driver as replies."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from dynamixel_sdk import PacketHandler

from slot_core import config
from slot_core.dynamixel import packet
from slot_core.dynamixel.bus import Bus
from slot_core.dynamixel.driver import FAST
from slot_core.dynamixel.emulator.emulated_bus import EmulatedBus, Reply, read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels
from slot_core.dynamixel.emulator.memory_port import MemoryPort
from slot_core.dynamixel.packet import BROADCAST, HEADER, Instruction, build
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import REGISTERS, TABLE, span

SDK = PacketHandler(2.0)
BAUD = 1000000
IDS = read_settings().joints.ids
INSTRUCTIONS = tuple(Instruction)
MUTATIONS = 6
BATCH = 100  # packets between two time steps
REACTION = 0.01  # s, in which a servo moves if it takes a damaged packet


@dataclass
class Tally:
    """Counts of the packets by outcome."""

    packets: int = 0
    crashes: int = 0
    corruption: int = 0  # accepted although the SDK's CRC does not match: an error
    collisions: int = 0  # a packet other than the one sent, whose CRC matches by chance
    intact: int = 0  # the packet sent, with other bytes beside it
    motion: float = 0.0  # rad, largest, without an undamaged packet
    crash: str = ""


def mutate(data: bytes, rng: np.random.Generator) -> bytes:
    """A packet with bits inverted, bytes inserted, removed, changed or cut off, or random bytes."""
    kind, out = rng.integers(MUTATIONS), bytearray(data)
    where = int(rng.integers(len(out)))
    if kind == 0:
        for _ in range(rng.integers(1, 9)):
            out[rng.integers(len(out))] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        out[where:where] = rng.bytes(rng.integers(1, 6))
    elif kind == 2:
        del out[where : where + int(rng.integers(1, 6))]
    elif kind == 3:
        del out[where:]
    elif kind == 4:
        out[where] = int(rng.integers(256))
    else:
        head = HEADER if rng.random() < 0.5 else b""
        return head + bytes(rng.bytes(rng.integers(1, 40)))
    return bytes(out)


def frames(data: bytes) -> list[bytes]:
    """All parts of `data` that are packets with a CRC valid by the SDK."""
    found, start = [], data.find(HEADER)
    while start >= 0:
        size = int.from_bytes(data[start + 5 : start + 7], "little") + 7
        frame = data[start : start + size]
        complete = len(frame) == size >= 10
        if complete and SDK.updateCRC(0, list(frame), size - 2) == frame[-2] | frame[-1] << 8:
            found.append(frame)
        start = data.find(HEADER, start + 1)
    return found


def _field(name: str, value: int) -> bytes:
    register = TABLE[name]
    return register.address.to_bytes(2, "little") + register.encode(value)


def instructions() -> list[bytes]:
    """Packets of the driver, and those with the worst effects: torque off, reboot, action."""
    goals = b"".join(bytes([i]) + TABLE["goal_position"].encode(2800) for i in IDS)
    pwm = b"".join(bytes([i]) + TABLE["goal_pwm"].encode(885) for i in IDS)
    address, size = span(*FAST)
    fast = address.to_bytes(2, "little") + size.to_bytes(2, "little") + bytes(IDS)
    return [
        build(BROADCAST, Instruction.SYNC_WRITE, b"\x74\0\4\0" + goals),
        build(BROADCAST, Instruction.SYNC_WRITE, b"\x64\0\2\0" + pwm),
        build(BROADCAST, Instruction.FAST_SYNC_READ, fast),
        build(BROADCAST, Instruction.SYNC_READ, fast),
        build(IDS[0], Instruction.WRITE, _field("goal_position", 2800)),
        build(IDS[1], Instruction.WRITE, _field("torque_enable", 0)),
        build(IDS[2], Instruction.REG_WRITE, _field("goal_position", 1500)),
        build(BROADCAST, Instruction.ACTION),
        build(IDS[3], Instruction.READ, b"\x40\0\1\0"),
        build(IDS[3], Instruction.REBOOT),
    ]


def fuzz_emulator(count: int, rng: np.random.Generator) -> Tally:
    """Mutated instructions to four servos that hold their position, torque on."""
    tally, corpus = Tally(), instructions()
    bus = _holding_bus()
    start, kept = bus.advance(0.0), _memories(bus)
    for number in range(count):
        original = corpus[number % len(corpus)]
        data = mutate(original, rng)
        if data != original:
            _send(bus, data, original, kept, tally)
        if number % BATCH == 0:
            moved = float(np.abs(bus.advance(0.001) - start).max())
            tally.motion = max(tally.motion, moved)
            kept = _memories(bus)
    return tally


def _holding_bus() -> EmulatedBus:
    legs = EmulatedDynamixels(read_settings(), read_emulator(), (0.5,) * 4)
    for servo in legs.bus.servos:
        servo.memory["goal_position"] = servo.position()
        servo.memory["torque_enable"] = 1
    for _ in range(200):
        legs.advance(0.001)
    return legs.bus


def _memories(bus: EmulatedBus) -> list[bytes]:
    return [servo.memory.image() for servo in bus.servos]


def _send(bus: EmulatedBus, data: bytes, original: bytes, kept: list[bytes], tally: Tally) -> None:
    tally.packets += 1
    bus.discard_partial()
    try:
        replies = bus.receive(data, BAUD)
    except Exception as error:  # every exception counts as a crash
        tally.crashes, tally.crash = tally.crashes + 1, repr(error)
        return
    answers = [p for reply in replies for p in packet.Parser().feed(reply.data)]
    accepted = any(p.parameters[0] & 0x7F != packet.Error.CRC for p in answers)
    if not accepted and _memories(bus) == kept:
        return
    found = frames(data)
    _classify(found, [original], tally)
    if not found:
        before = bus.advance(0.0)
        moved = float(np.abs(bus.advance(REACTION) - before).max())
        tally.motion = max(tally.motion, moved)
    for servo, image in zip(bus.servos, kept):
        servo.load_image(image)


def _classify(found: list[bytes], sent: list[bytes], tally: Tally) -> None:
    if not found:
        tally.corruption += 1
    elif any(frame not in sent for frame in found):
        tally.collisions += 1
    else:
        tally.intact += 1


def fuzz_instructions(count: int, rng: np.random.Generator) -> Tally:
    """Random contents with a valid CRC; a register out of its range counts as corruption."""
    tally, bus = Tally(), _holding_bus()
    kept = _memories(bus)
    for number in range(count):
        code = int(rng.choice(INSTRUCTIONS)) if rng.random() < 0.9 else int(rng.integers(256))
        identity = int(rng.choice([*IDS, BROADCAST]))
        parameters = bytearray(rng.bytes(rng.integers(0, 24)))
        if len(parameters) > 4 and rng.random() < 0.8:  # addresses within the table
            parameters[1] = parameters[3] = 0
        tally.packets += 1
        try:
            bus.receive(build(identity, code, bytes(parameters)), BAUD)
            bus.advance(0.001)
            tally.corruption += any(_out_of_range(servo.memory) for servo in bus.servos)
        except Exception as error:  # every exception counts as a crash
            tally.crashes, tally.crash = tally.crashes + 1, repr(error)
        if number % BATCH == 0:
            for servo, image in zip(bus.servos, kept):
                servo.load_image(image)
    return tally


def _out_of_range(memory: object) -> bool:
    return any(
        not register.low <= memory[register.name] <= register.high  # type: ignore[index]
        for register in REGISTERS
        if register.writable and register.name not in {"bus_watchdog"} and register.address < 168
    )


class ScriptedBus:
    """Stands for a bus of servos: replies to every packet with scripted bytes."""

    unplugged, answer = False, b""

    def receive(self, data: bytes, baud: int) -> list[Reply]:
        """The reply, at once."""
        return [Reply(self.answer, 0.0)]


def fuzz_driver(count: int, rng: np.random.Generator) -> Tally:
    """Mutated replies to the driver's fast and plain sync read."""
    tally, line = Tally(), ScriptedBus()
    settings = config.replace(read_settings().bus, {"retries": 0})
    bus = Bus(MemoryPort(line, BAUD, time.monotonic), settings)
    for _ in range(count):
        truth = {identity: _data(rng) for identity in IDS}
        fast = bool(rng.integers(2))
        bus.clear_silent()
        replies = [(identity, 0, read) for identity, read in truth.items()]
        sent = [packet.fast_status(replies)] if fast else [packet.status(*r) for r in replies]
        which = int(rng.integers(len(sent)))
        data = b"".join(mutate(d, rng) if k == which else d for k, d in enumerate(sent))
        line.answer = data
        tally.packets += 1
        try:
            answers = bus.sync_read(IDS, *FAST, fast)
        except Exception as error:  # every exception counts as a crash
            tally.crashes, tally.crash = tally.crashes + 1, repr(error)
            continue
        if any(_bytes(answer.values) != truth[i] for i, answer in answers.items()):
            _classify([f for f in frames(data) if f not in sent], [], tally)
        else:
            tally.intact += bool(answers)
    return tally


def _data(rng: np.random.Generator) -> bytes:
    """Ten bytes, often with sequences that need byte stuffing."""
    return bytes(rng.choice(np.array([0, 1, 0xFD, 0xFF], dtype=np.uint8), 10))


def _bytes(values: object) -> bytes:
    names = ("present_load", "present_velocity", "present_position")
    return b"".join(TABLE[name].encode(values[name]) for name in names)  # type: ignore[index]
