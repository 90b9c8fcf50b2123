"""Reading and writing registers of servos by name, on dynamixel-sdk's packet handler.

The SDK's group classes are not used for reading: with one servo silent they drop the answers of the
others, they do not look at the error byte, and of an answer that only says "refused" they take the
CRC for data. Here an answer counts only if its id, its length, its CRC and its error number are
right; a servo without such an answer has no values.

The answers to different reads of the driver differ in length, so that a late one is not taken for
another.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from dynamixel_sdk import COMM_RX_CORRUPT, COMM_SUCCESS, GroupSyncWrite, PacketHandler

from slot_core.dynamixel.errors import CommunicationError, InstructionError
from slot_core.dynamixel.packet import ALERT, BROADCAST, Error
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import BusSettings
from slot_core.dynamixel.table import TABLE, decode_span, span

PROTOCOL = 2.0
STATUS_BYTES = 11  # of a status packet without parameters


@dataclass(frozen=True)
class Answer:
    """Values by register, and whether the servo asks to look at its hardware error status."""

    values: Mapping[str, int]
    alert: bool


@dataclass(frozen=True)
class _Status:
    """A status packet: its error byte and parameters."""

    error: int
    data: bytes

    @property
    def number(self) -> int:
        return self.error & ~ALERT


class Quality:
    """How many of the last exchanges with a servo failed."""

    def __init__(self, window: int) -> None:
        self._failed: deque[bool] = deque(maxlen=window)
        self.exchanges = 0
        self.failures = 0  # both over all time

    def add(self, failed: bool) -> None:
        """Count one exchange."""
        self._failed.append(failed)
        self.exchanges += 1
        self.failures += failed

    @property
    def error_rate(self) -> float:
        """Share of failed exchanges within the window; 0 before the first."""
        return sum(self._failed) / len(self._failed) if self._failed else 0.0


class Bus:
    """All exchanges with servos; `names` is how messages call them."""

    def __init__(
        self, port: SerialPort, settings: BusSettings, names: Mapping[int, str] | None = None
    ) -> None:
        self.port = port
        self._settings = settings
        self._handler: Any = PacketHandler(PROTOCOL)
        self._names = dict(names or {})
        self._silent: set[int] = set()
        self.quality: dict[int, Quality] = {}

    def name(self, identity: int) -> str:
        """How messages call a servo."""
        return self._names.get(identity, f"servo id {identity}")

    def ping(self, identity: int) -> tuple[int, int]:
        """Model number and firmware; raises CommunicationError, InstructionError."""
        data = self._exchange(identity, lambda: self._ping(identity), 3, "ping")
        return data[0] | data[1] << 8, data[2]

    def scan(self) -> dict[int, tuple[int, int]]:
        """Model and firmware of all servos that answer on the line, by id; takes about a second."""
        found, _ = self._handler.broadcastPing(self.port)
        return {identity: (model, firmware) for identity, (model, firmware) in found.items()}

    def read(self, identity: int, first: str, last: str | None = None) -> dict[str, int]:
        """Values from one register to another; raises CommunicationError, InstructionError."""
        address, size = span(first, last or first)
        ask = self._handler.readTx
        data = self._exchange(
            identity, lambda: ask(self.port, identity, address, size), size, f"reading {first}"
        )
        return decode_span(address, data)

    def write(self, identity: int, register: str, value: int) -> None:
        """Write one register; raises CommunicationError, InstructionError."""
        item = TABLE[register]
        data = list(item.encode(value))
        self._exchange(
            identity,
            lambda: self._write(identity, item.address, data),
            0,
            f"writing {register} = {value}",
        )

    def confirm(self, identity: int, register: str, value: int) -> None:
        """Write one register and read it back; raises InstructionError where it is another."""
        self.write(identity, register, value)
        found = self.read(identity, register)[register]
        if found != value:
            raise InstructionError(
                f"{self.name(identity)}: {register} is {found} after {value} was written"
            )

    def reboot(self, identity: int) -> None:
        """Restart a servo; it does not answer for a while. Raises CommunicationError."""
        result, error = self._handler.reboot(self.port, identity)
        if result != COMM_SUCCESS:
            raise CommunicationError(f"{self.name(identity)}: reboot: {self._words(result)}")
        if error & ~ALERT:
            raise InstructionError(f"{self.name(identity)}: reboot: {self._refusal(error)}")

    def sync_write(self, register: str, values: Mapping[int, int]) -> None:
        """Write one register of several servos at once; there is no answer."""
        item = TABLE[register]
        group = GroupSyncWrite(self.port, self._handler, item.address, item.size)
        for identity, value in values.items():
            group.addParam(identity, list(item.encode(value)))
        result = group.txPacket()
        if result != COMM_SUCCESS:
            raise CommunicationError(f"writing {register} of all servos: {self._words(result)}")

    def sync_read(self, ids: Iterable[int], first: str, last: str, fast: bool) -> dict[int, Answer]:
        """Values of those servos that answered; `fast` where all of them know fast sync read.

        Who does not answer is asked again by itself, `retries` times; who did not answer then is
        asked once a call, and last, until it does. Where a fast answer fails, it counts as failed
        for all: whose fault it was cannot be told.
        """
        wanted = sorted(ids, key=lambda identity: identity in self._silent)  # stable
        address, size = span(first, last)
        fast = fast and not self._silent.intersection(wanted)
        found = self._fast_read(wanted, address, size) if fast else {}
        if not fast:
            found = self._sync_read(wanted, address, size)
        for identity in wanted:
            self._count(identity, identity not in found)
            if identity not in found and identity not in self._silent:
                found |= self._read_alone(identity, address, size)
        self._silent = (self._silent - set(wanted)) | (set(wanted) - set(found))
        return {
            identity: Answer(decode_span(address, status.data), bool(status.error & ALERT))
            for identity, status in found.items()
        }

    def forget_silence(self) -> None:
        """Ask all servos as if they had always answered."""
        self._silent.clear()

    def _fast_read(self, ids: list[int], address: int, size: int) -> dict[int, _Status]:
        result = self._handler.syncReadTx(self.port, address, size, ids, len(ids), True)
        if result != COMM_SUCCESS:
            return {}
        packet, result = self._handler.rxPacket(self.port, True)
        length = 1 + len(ids) * (size + 4)
        if result != COMM_SUCCESS or packet[4] != BROADCAST or _length(packet) != length:
            self.port.drain(self._settings.quiet)
            return {}
        parts = [bytes(packet[8 + k * (size + 4) :][: size + 2]) for k in range(len(ids))]
        return {
            part[1]: _Status(part[0], part[2:])
            for identity, part in zip(ids, parts)
            if part[1] == identity and not part[0] & ~ALERT
        }

    def _sync_read(self, ids: list[int], address: int, size: int) -> dict[int, _Status]:
        result = self._handler.syncReadTx(self.port, address, size, ids, len(ids), False)
        if result != COMM_SUCCESS:
            return {}
        found, _ = self._receive(ids, size)
        return {identity: status for identity, status in found.items() if not status.number}

    def _read_alone(self, identity: int, address: int, size: int) -> dict[int, _Status]:
        for _ in range(self._settings.retries):
            self._handler.readTx(self.port, identity, address, size)
            found, _ = self._receive([identity], size)
            usable = identity in found and not found[identity].number
            self._count(identity, not usable)
            if usable:
                return found
        return {}

    def _exchange(self, identity: int, send: Callable[[], int], size: int, action: str) -> bytes:
        """Send until a right answer comes, at most `retries` times more; returns its data."""
        cause = ""
        for _ in range(self._settings.retries + 1):
            found: dict[int, _Status] = {}
            result = send()
            if result == COMM_SUCCESS:
                found, result = self._receive([identity], size)
            self._count(identity, identity not in found)
            status = found.get(identity)
            if status is not None and not status.number:
                return status.data
            cause = self._words(result) if status is None else self._refusal(status.error)
            if status is not None and status.number != Error.CRC:  # that is damage on the way
                raise InstructionError(f"{self.name(identity)}: {action}: {cause}")
        raise CommunicationError(f"{self.name(identity)}: {action}: {cause}")

    def _ping(self, identity: int) -> int:
        packet = [0] * 10
        packet[4], packet[5], packet[7] = identity, 3, 1
        result: int = self._handler.txPacket(self.port, packet)
        self.port.setPacketTimeout(STATUS_BYTES + 3)
        return result

    def _write(self, identity: int, address: int, data: list[int]) -> int:
        result: int = self._handler.writeTxOnly(self.port, identity, address, len(data), data)
        self.port.setPacketTimeout(STATUS_BYTES)
        return result

    def _receive(self, ids: list[int], size: int) -> tuple[dict[int, _Status], int]:
        """Answers of `size` bytes by id, and the SDK's result for the last packet that failed."""
        found: dict[int, _Status] = {}
        result, wrong = COMM_SUCCESS, 0
        while len(found) < len(ids) and wrong <= len(ids):
            packet, result = self._handler.rxPacket(self.port, False)
            status = _status(packet, size) if result == COMM_SUCCESS else None
            if status is not None and packet[4] in ids:
                found[packet[4]] = status
                continue
            wrong += 1
            if result == COMM_SUCCESS:
                result = COMM_RX_CORRUPT
            elif self.port.packet_timeout == 0:  # the SDK's sign that the time is up
                break
        if len(found) < len(ids):
            self.port.drain(self._settings.quiet)
        return found, result

    def _count(self, identity: int, failed: bool) -> None:
        if identity not in self.quality:
            self.quality[identity] = Quality(self._settings.window)
        self.quality[identity].add(failed)

    def _words(self, result: int) -> str:
        return str(self._handler.getTxRxResult(result))

    def _refusal(self, error: int) -> str:
        return str(self._handler.getRxPacketError(error & ~ALERT))


def _length(packet: list[int]) -> int:
    return packet[5] | packet[6] << 8


def _status(packet: list[int], size: int) -> _Status | None:
    """The status in a packet of the SDK, unless it is neither a refusal nor `size` bytes."""
    length = _length(packet)
    if length < 4 or len(packet) < length + 7:
        return None
    status = _Status(packet[8], bytes(packet[9 : length + 5]))
    wanted = 0 if status.number else size
    return status if len(status.data) == wanted else None
