"""An emulated bus of XL430-W250: packets in, packets out, faults, time.

Every servo sees every byte. In the chain of a sync or bulk read a servo answers after the one
before it has: where one is silent, those behind it are too (the worse of what users report). A
packet with a wrong CRC to one servo is answered with the CRC error; to all, not at all. Every
intact instruction on the bus, to whichever servo, resets the bus watchdogs.
"""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from slot_core import config
from slot_core.config import quantity
from slot_core.dynamics.servo import read_servo, servo
from slot_core.dynamixel.packet import (
    BROADCAST,
    LONGEST,
    Error,
    Instruction,
    Packet,
    Parser,
    fast_status,
    status,
)
from slot_core.dynamixel.table import BAUD_RATES, RETURN_DELAY_UNIT, HardwareError
from slot_core.emulator.emulated_servo import EmulatedServo, ServoModel
from slot_core.emulator.instructions import execute, read_data, word
from slot_core.emulator.line_faults import LineFaults, damaged
from slot_core.emulator.shaft import Motor
from slot_core.faults import Fault
from slot_core.robot import LEGS

FAST_BYTES = 4  # of each servo in a fast answer, beside its data
ANSWER_READS, ANSWER_ALL = 1, 2  # status return levels beside 0, ping alone


@dataclass(frozen=True)
class EmulatorSettings:
    """What `config/emulator.yaml` holds."""

    servo: ServoModel
    usb_latency: float = quantity("of the adapter, for each batch of answers", "s", 0.0, 0.1)
    seed: int = quantity("of the noise on the line", "", 0, 2**31)


@dataclass(frozen=True)
class Reply:
    """Bytes on the line, and the silence before them (s)."""

    data: bytes
    delay: float


class EmulatedBus:
    """Four servos on one line. `receive` and `advance` may be called from different threads."""

    def __init__(
        self, settings: EmulatorSettings, ids: Sequence[int], angles: Sequence[float]
    ) -> None:
        law = servo(read_servo())
        motor = Motor(law.speed, 1.0 / law.yielding if law.yielding else np.inf, law.motor_time)
        self.settings = settings
        self.servos = tuple(
            EmulatedServo(identity, settings.servo, motor, angle)
            for identity, angle in zip(ids, angles)
        )
        self.unplugged = False
        self.time = 0.0
        self._line = tuple(LineFaults() for _ in self.servos)
        self._true_ids = tuple(ids)
        self._parser = Parser()
        self._rng = np.random.default_rng(settings.seed)
        self._lock = threading.RLock()

    def receive(self, data: bytes, baud: int) -> list[Reply]:
        """Answers to bytes that come in at a rate; servos of another rate do not hear them."""
        with self._lock:
            replies = []
            for packet in self._parser.feed(data):
                replies += self._handle(packet, baud)
            return replies

    def hush(self) -> None:
        """A pause on the line: what has come of a packet is void."""
        with self._lock:
            self._parser.reset()

    def advance(
        self, dt: float, loads: Sequence[float] | npt.NDArray[np.float64] = (0.0,) * 4
    ) -> npt.NDArray[np.float64]:
        """Let dt s pass under load torques (N m) on the servos; returns their angles (rad)."""
        with self._lock:
            self.time += dt
            for each, load in zip(self.servos, loads):
                each.advance(dt, float(load))
            return np.array([each.shaft.angle for each in self.servos])

    def inject(self, fault: Fault) -> None:
        """A fault from now on, whatever its time says."""
        with self._lock:
            for leg in fault.legs:
                self._set(LEGS.index(leg), fault, True)

    def clear(self, fault: Fault) -> None:
        """Take a fault back; hardware errors stay until a servo is rebooted."""
        with self._lock:
            for leg in fault.legs:
                self._set(LEGS.index(leg), fault, False)

    def _set(self, index: int, fault: Fault, on: bool) -> None:
        each, line = self.servos[index], self._line[index]
        if fault.kind == "silent":
            line.silent = on
        elif fault.kind == "corrupt":
            line.corrupt = fault.value if on else 0.0
        elif fault.kind == "late":
            line.late = fault.value if on else 0.0
        elif fault.kind == "wrong_id":
            each.memory["id"] = int(fault.value) if on else self._true_ids[index]
        elif fault.kind == "overheating":
            each.forced_temperature = fault.value if on else np.nan
        elif fault.kind == "undervoltage":
            each.voltage = fault.value if on else each.model.voltage
        elif fault.kind == "unplugged":
            self.unplugged = on
        elif on:
            _SUDDEN[fault.kind](each)

    def _handle(self, packet: Packet, baud: int) -> list[Reply]:
        there = [
            (index, each)
            for index, each in enumerate(self.servos)
            if each.awake and BAUD_RATES[each.memory["baud_rate"]] == baud
        ]
        if not packet.intact:
            return [
                reply
                for index, each in there
                if packet.id == each.memory["id"]
                for reply in self._answer(index, status(packet.id, each.error | Error.CRC))
            ]
        if packet.instruction == Instruction.STATUS:
            return []
        for _, each in there:
            each.heard = each.time
        return list(self._dispatch(packet, there))

    def _dispatch(self, packet: Packet, there: list[tuple[int, EmulatedServo]]) -> Iterator[Reply]:
        if packet.instruction in _CHAINED and packet.id == BROADCAST:
            yield from self._chain(packet, there)
            return
        for index, each in sorted(there, key=lambda item: item[1].memory["id"]):
            mine = packet.id == each.memory["id"]
            shadow = packet.id == each.memory["secondary_id"] != 255
            if not (mine or shadow or packet.id == BROADCAST):
                continue
            identity = each.memory["id"]  # the answer has the old one
            level = each.memory["status_return_level"]
            error, data = execute(each, packet)
            ping = packet.instruction == Instruction.PING
            reads = packet.instruction == Instruction.READ
            quiet = not (ping or level == ANSWER_ALL or (reads and level >= ANSWER_READS))
            if quiet or not (mine or (ping and packet.id == BROADCAST)):
                continue
            yield from self._answer(index, status(identity, error, data))

    def _chain(self, packet: Packet, there: list[tuple[int, EmulatedServo]]) -> Iterator[Reply]:
        """Sync and bulk reads: the servos named answer one after the other."""
        by_id = {each.memory["id"]: (index, each) for index, each in there}
        fast = packet.instruction in {Instruction.FAST_SYNC_READ, Instruction.FAST_BULK_READ}
        parts, delay = [], 0.0
        asked = list(_requests(packet))
        if fast and sum(size + FAST_BYTES for _, _, size in asked) > LONGEST:
            return  # no packet can hold the answer
        for identity, address, size in asked:
            index, each = by_id.get(identity, (-1, None))
            if each is None or self._line[index].silent:
                break
            if each.memory["status_return_level"] < ANSWER_READS:
                break
            error, data = read_data(each, address, size)
            if fast:
                delay = delay or self._delay(index)
                parts.append((index, (identity, error, data.ljust(size, b"\0"))))
                continue
            yield from self._answer(index, status(identity, error, data))
        if parts:
            yield from self._fast_answer(parts, len(asked), delay)

    def _fast_answer(
        self, parts: list[tuple[int, tuple[int, int, bytes]]], wanted: int, delay: float
    ) -> Iterator[Reply]:
        """One packet of all; where the chain broke, its length promises more than comes."""
        whole = parts + [parts[-1]] * (wanted - len(parts))
        data = fast_status([part for _, part in whole])
        data = data[: len(fast_status([part for _, part in parts]))]
        for index, _ in parts:
            if self._rng.random() < self._line[index].corrupt:
                data = damaged(data, self._rng)
        late = max(self._line[index].late for index, _ in parts)
        yield Reply(data, delay + late)

    def _answer(self, index: int, data: bytes) -> Iterator[Reply]:
        line = self._line[index]
        if line.silent:
            return
        if self._rng.random() < line.corrupt:
            data = damaged(data, self._rng)
        yield Reply(data, self._delay(index) + line.late)

    def _delay(self, index: int) -> float:
        return self.servos[index].memory["return_delay_time"] * RETURN_DELAY_UNIT


_CHAINED = {
    Instruction.SYNC_READ,
    Instruction.FAST_SYNC_READ,
    Instruction.BULK_READ,
    Instruction.FAST_BULK_READ,
}
_SUDDEN = {
    "overload": lambda each: each.trip(HardwareError.OVERLOAD),
    "watchdog": lambda each: each.stop_by_watchdog(),
}


def read_emulator() -> EmulatorSettings:
    """The settings of `config/emulator.yaml`; raises ConfigError."""
    return config.read(EmulatorSettings, "emulator")


def _requests(packet: Packet) -> Iterator[tuple[int, int, int]]:
    """Who is asked by a sync or bulk read, for which address and size."""
    parameters = packet.parameters
    if packet.instruction in {Instruction.SYNC_READ, Instruction.FAST_SYNC_READ}:
        for identity in parameters[4:]:
            yield identity, word(parameters[:2]), word(parameters[2:4])
        return
    for start in range(0, len(parameters) - 4, 5):
        part = parameters[start : start + 5]
        yield part[0], word(part[1:3]), word(part[3:5])
