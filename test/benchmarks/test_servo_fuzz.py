"""Random and mutated packets to emulator and driver; scripts/bench servo sends a million."""

import numpy as np

from benchmarks.servo import fuzz

COUNT = 5000


def test_no_damaged_packet_crashes_moves_or_changes_a_servo():
    tally = fuzz.fuzz_emulator(COUNT, np.random.default_rng(1))
    assert tally.packets > 0.9 * COUNT
    assert (tally.crashes, tally.corruption, tally.motion) == (0, 0, 0.0), tally.crash


def test_no_damaged_reply_becomes_a_reading():
    tally = fuzz.fuzz_driver(COUNT, np.random.default_rng(2))
    assert tally.intact > 0.2 * COUNT  # undamaged replies are read
    assert (tally.crashes, tally.corruption) == (0, 0), tally.crash


def test_random_instructions_leave_registers_within_their_range():
    tally = fuzz.fuzz_instructions(COUNT // 2, np.random.default_rng(3))
    assert (tally.crashes, tally.corruption) == (0, 0), tally.crash


def test_the_fuzz_detects_a_receiver_without_a_crc_check(monkeypatch):
    """A parser that accepts every CRC must count as corruption, and its servos move."""
    monkeypatch.setattr("slot_core.dynamixel.packet.Parser._take", _accept_any_crc)
    tally = fuzz.fuzz_emulator(COUNT // 5, np.random.default_rng(1))
    assert tally.corruption > 0
    assert tally.motion > 0.0


def _accept_any_crc(parser, size):
    from slot_core.dynamixel.packet import Packet, unstuff  # noqa: PLC0415

    data = bytes(parser._buffer[:size])
    del parser._buffer[:size]
    return Packet(data[4], data[7], unstuff(data[8:-2]), size)
