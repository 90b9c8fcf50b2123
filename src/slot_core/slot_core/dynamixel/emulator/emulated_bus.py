"""Emulated bus of four XL430-W250: instruction packets in, status packets out, faults, time.

Every servo receives every byte. In a sync read each servo answers after the one before it
has answered: if one does not answer, those after it do not either (the worse of the two behaviours
that users report). A packet with a wrong CRC is answered with the CRC error if it has the id of one
servo, and not at all if it is a broadcast. Every intact instruction on the bus, of any id, restarts
the bus watchdogs of all servos.

Instructions of Protocol 2.0 on an emulated servo; error numbers: `emulated_servo.py`.

Reg Write, Action, Factory Reset, Clear and the bulk instructions are answered as unknown: no driver
here sends them.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import dynamixel_sdk as sdk
import numpy as np
import numpy.typing as npt

from slot_core import config
from slot_core.config import quantity
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.emulator.emulated_servo import (
    EmulatedServo,
    Motor,
    RegisterError,
    ServoModel,
)
from slot_core.dynamixel.packet import (
    FAST_OVERHEAD,
    PACKET_MAX,
    Packet,
    Parser,
    fast_status,
    status,
)
from slot_core.dynamixel.table import (
    ANSWER_ALL,
    ANSWER_READS,
    BAUD_RATES,
    MODEL_NUMBER,
    NO_SECONDARY_ID,
    RETURN_DELAY_UNIT,
)
from slot_core.faults import Fault, HardwareError
from slot_core.robot import LEGS


def uint16(data: bytes) -> int:
    """Unsigned number in two bytes."""
    return int.from_bytes(data, "little")


def answer(
    servo: EmulatedServo, action: Callable[[], bytes]
) -> tuple[int, bytes]:
    """Error byte and data of the answer to an instruction that does `action`."""
    try:
        data = action()
    except RegisterError as rejection:
        return servo.error | rejection.number, b""
    return servo.error, data


def execute(servo: EmulatedServo, packet: Packet) -> bytes:
    """Execute an instruction other than a sync read; data of the answer. Raises RegisterError."""
    given, address = packet.parameters, uint16(packet.parameters[:2])
    match packet.instruction:
        case sdk.INST_PING:
            model = MODEL_NUMBER.to_bytes(2, "little")
            return model + bytes([servo.memory["firmware_version"]])
        case sdk.INST_READ if len(given) == 4 and packet.id != sdk.BROADCAST_ID:
            return servo.read(address, uint16(given[2:]))
        case sdk.INST_WRITE if len(given) >= 3:
            servo.write(address, given[2:])
        case sdk.INST_READ | sdk.INST_WRITE:
            raise RegisterError(sdk.ERRNUM_DATA_LENGTH)
        case sdk.INST_REBOOT:
            servo.reboot()
        case sdk.INST_SYNC_WRITE if packet.id == sdk.BROADCAST_ID:
            size = uint16(given[2:4])
            for start in range(4, len(given) - size, size + 1):
                if given[start] == servo.memory["id"]:
                    servo.write(address, given[start + 1 : start + 1 + size])
                    break
        case _:
            raise RegisterError(sdk.ERRNUM_INSTRUCTION)
    return b""


@dataclass(frozen=True)
class EmulatorSettings:
    """Contents of `config/emulator.yaml`."""

    servo: ServoModel
    usb_latency: float = quantity(
        "latency of the adapter, for each batch of answers", "s", 0.0, 0.1
    )
    seed: int = quantity("seed of the noise on the line", "", 0, 2**31)


@dataclass(frozen=True)
class Reply:
    """Bytes of an answer, and the delay before them (s)."""

    data: bytes
    delay: float


@dataclass
class LineFaults:
    """Faults in the answers of one servo."""

    silent: bool = False  # no answers
    corrupt: float = 0.0  # fraction of its answers that are corrupted
    late: float = 0.0  # s, additional delay of its answers


class EmulatedBus:
    """Four servos on one line, at initial angles (rad), in the order of LEGS.

    `receive` and `advance` may be called from different threads. Raises ConfigError for a supply
    voltage outside the range of `servo.yaml`.
    """

    def __init__(
        self,
        settings: EmulatorSettings,
        ids: Sequence[int],
        angles: Sequence[float],
    ) -> None:
        servo, voltage = read_servo(), settings.servo.voltage
        servo.require_voltage(voltage)
        speed, stall = float(servo.speed(voltage)), float(servo.stall(voltage))
        motor = Motor(voltage, speed, stall, servo.motor_time)
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
        """Answers to bytes sent at a baud rate; servos set to another one do not receive them."""
        with self._lock:
            replies = []
            for packet in self._parser.feed(data):
                replies += self._handle(packet, baud)
            return replies

    def discard_partial(self) -> None:
        """Discard an incomplete packet, as after a pause on the line."""
        with self._lock:
            self._parser.reset()

    def advance(
        self,
        dt: float,
        loads: Sequence[float] | npt.NDArray[np.float64] = (0.0,) * 4,
    ) -> npt.NDArray[np.float64]:
        """Advance by dt s under load torques (4,), N m; returns the servo angles (4,), rad."""
        with self._lock:
            self.time += dt
            for servo, load in zip(self.servos, loads):
                servo.advance(dt, float(load))
            return np.array([servo.shaft.angle for servo in self.servos])

    def watchdog_left(self) -> float:
        """Time after which the first bus watchdog stops its servo, s; inf if none is armed."""
        with self._lock:
            return min(servo.watchdog_left() for servo in self.servos)

    def set_fault(self, fault: Fault, on: bool) -> None:
        """Start a fault now, or end it: then hardware errors stay until the servo is rebooted."""
        with self._lock:
            for leg in fault.legs:
                self._apply(LEGS.index(leg), fault, on)

    def _apply(self, index: int, fault: Fault, on: bool) -> None:
        servo, line = self.servos[index], self._line[index]
        if fault.kind == "silent":
            line.silent = on
        elif fault.kind == "corrupt":
            line.corrupt = fault.value if on else 0.0
        elif fault.kind == "late":
            line.late = fault.value if on else 0.0
        elif fault.kind == "wrong_id":
            servo.memory["id"] = (
                int(fault.value) if on else self._true_ids[index]
            )
        elif fault.kind == "overheating":
            servo.forced_temperature = fault.value if on else np.nan
        elif fault.kind == "undervoltage":
            servo.voltage = fault.value if on else servo.model.voltage
        elif fault.kind == "unplugged":
            self.unplugged = on
        elif on:
            _EVENTS[fault.kind](servo)

    def _handle(self, packet: Packet, baud: int) -> list[Reply]:
        receivers = [
            (index, servo)
            for index, servo in enumerate(self.servos)
            if servo.awake and BAUD_RATES[servo.memory["baud_rate"]] == baud
        ]
        if not packet.intact:
            return [
                reply
                for index, servo in receivers
                if packet.id == servo.memory["id"]
                for reply in self._answer(
                    index, status(packet.id, servo.error | sdk.ERRNUM_CRC)
                )
            ]
        if packet.instruction == sdk.INST_STATUS:
            return []
        for _, servo in receivers:
            servo.last_instruction = servo.time
        return list(self._dispatch(packet, receivers))

    def _dispatch(
        self, packet: Packet, receivers: list[tuple[int, EmulatedServo]]
    ) -> Iterator[Reply]:
        if packet.id == sdk.BROADCAST_ID and packet.instruction in (
            sdk.INST_SYNC_READ,
            sdk.INST_FAST_SYNC_READ,
        ):
            yield from self._chain(packet, receivers)
            return
        for index, servo in sorted(
            receivers, key=lambda item: item[1].memory["id"]
        ):
            own = packet.id == servo.memory["id"]
            secondary = (
                packet.id == servo.memory["secondary_id"] != NO_SECONDARY_ID
            )
            if not (own or secondary or packet.id == sdk.BROADCAST_ID):
                continue
            # the answer has the id before the instruction
            identity = servo.memory["id"]
            level = servo.memory["status_return_level"]
            error, data = answer(servo, partial(execute, servo, packet))
            ping = packet.instruction == sdk.INST_PING
            reads = packet.instruction == sdk.INST_READ
            answered = (
                ping or level == ANSWER_ALL or (reads and level >= ANSWER_READS)
            )
            if answered and (own or (ping and packet.id == sdk.BROADCAST_ID)):
                yield from self._answer(index, status(identity, error, data))

    def _chain(
        self, packet: Packet, receivers: list[tuple[int, EmulatedServo]]
    ) -> Iterator[Reply]:
        """Answers to a sync read, one servo after the other."""
        by_id = {
            servo.memory["id"]: (index, servo) for index, servo in receivers
        }
        fast = packet.instruction == sdk.INST_FAST_SYNC_READ
        parts, delay = [], 0.0
        address, size = (
            uint16(packet.parameters[:2]),
            uint16(packet.parameters[2:4]),
        )
        ids = packet.parameters[4:]
        if fast and len(ids) * (size + FAST_OVERHEAD) > PACKET_MAX:
            return  # the answer is longer than a packet
        for identity in ids:
            index, servo = by_id.get(identity, (-1, None))
            if (
                servo is None
                or self._line[index].silent
                or servo.memory["status_return_level"] < ANSWER_READS
            ):
                break
            error, data = answer(servo, partial(servo.read, address, size))
            if fast:
                delay = delay or self._delay(index)
                parts.append(
                    (index, (identity, error, data.ljust(size, b"\0")))
                )
                continue
            yield from self._answer(index, status(identity, error, data))
        if parts:
            yield from self._fast_answer(parts, len(ids), delay)

    def _fast_answer(
        self,
        parts: list[tuple[int, tuple[int, int, bytes]]],
        count: int,
        delay: float,
    ) -> Iterator[Reply]:
        """Answer of `count` servos in one packet; cut off after `parts` if some do not answer."""
        whole = parts + [parts[-1]] * (count - len(parts))
        data = fast_status([part for _, part in whole])
        data = data[: len(fast_status([part for _, part in parts]))]
        for index, _ in parts:
            if self._rng.random() < self._line[index].corrupt:
                data = damaged(data, self._rng)
        yield Reply(
            data, delay + max(self._line[index].late for index, _ in parts)
        )

    def _answer(self, index: int, data: bytes) -> Iterator[Reply]:
        line = self._line[index]
        if line.silent:
            return
        if self._rng.random() < line.corrupt:
            data = damaged(data, self._rng)
        yield Reply(data, self._delay(index) + line.late)

    def _delay(self, index: int) -> float:
        return (
            self.servos[index].memory["return_delay_time"] * RETURN_DELAY_UNIT
        )


_EVENTS = {  # faults that happen at once and are not taken back
    "overload": lambda servo: servo.trip(HardwareError.OVERLOAD),
    "watchdog": lambda servo: servo.stop_by_watchdog(),
}


def read_emulator() -> EmulatorSettings:
    """The settings of `config/emulator.yaml`; raises ConfigError."""
    return config.read(EmulatorSettings, "emulator")


def damaged(data: bytes, rng: np.random.Generator) -> bytes:
    """The bytes with one random bit inverted, an error that the CRC always detects."""
    where, bit = rng.integers(len(data)), rng.integers(8)
    return data[:where] + bytes([data[where] ^ (1 << bit)]) + data[where + 1 :]
