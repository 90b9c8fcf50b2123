"""Packets against the examples of the e-manual, and the parser of a stream of them."""

import numpy as np
import pytest

from slot_core.dynamixel.packet import (
    BROADCAST,
    Instruction,
    Parser,
    build,
    status,
)

# ROBOTIS e-manual, Protocol 2.0, the examples of each instruction and its status packets.
EXAMPLES = [
    (build(1, Instruction.PING), "FFFFFD00 01 0300 01 194E"),
    (build(BROADCAST, Instruction.PING), "FFFFFD00 FE 0300 01 3142"),
    (status(1, 0, b"\x06\x04\x26"), "FFFFFD00 01 0700 55 00 060426 655D"),
    (status(2, 0, b"\x06\x04\x26"), "FFFFFD00 02 0700 55 00 060426 6F6D"),
    (
        build(1, Instruction.READ, b"\x84\0\4\0"),
        "FFFFFD00 01 0700 02 84000400 1D15",
    ),
    (status(1, 0, b"\xa6\0\0\0"), "FFFFFD00 01 0800 55 00 A6000000 8CC0"),
    (
        build(1, Instruction.WRITE, b"\x74\0\0\2\0\0"),
        "FFFFFD00 01 0900 03 740000020000 CA89",
    ),
    (status(1, 0), "FFFFFD00 01 0400 55 00 A10C"),
    (
        build(1, Instruction.REG_WRITE, b"\x68\0\xc8\0\0\0"),
        "FFFFFD00 01 0900 04 6800C8000000 AE8E",
    ),
    (build(1, Instruction.ACTION), "FFFFFD00 01 0300 05 02CE"),
    (build(1, Instruction.REBOOT), "FFFFFD00 01 0300 08 2F4E"),
    (
        build(BROADCAST, Instruction.SYNC_READ, b"\x84\0\4\0\1\2"),
        "FFFFFD00 FE 0900 82 840004000102 CEFA",
    ),
    (
        build(
            BROADCAST,
            Instruction.SYNC_WRITE,
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
    good = build(5, Instruction.PING)
    damaged = bytearray(build(5, Instruction.WRITE, bytes(20)))
    damaged[5] += 10  # its length now reaches into the next packet
    found = [p for p in Parser().feed(bytes(damaged) + good) if p.intact]
    assert [(p.id, p.instruction) for p in found] == [(5, Instruction.PING)]
