"""Servo bus: registers read and written by name, on dynamixel-sdk's packet handler.

The SDK's group classes are not used for reading: if one servo does not answer they drop the answers
of the others, they ignore the error byte, and in an answer that has only an error number they take
the CRC for data. Here an answer is valid only if its id, length, CRC and error number are right; a
servo without a valid answer has no values.

The reads of a bus cycle have answers of different lengths, so a late answer to one of them is not
taken for the answer to another.
"""

from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from dynamixel_sdk import (
    BROADCAST_ID,
    COMM_RX_CORRUPT,
    COMM_SUCCESS,
    ERRBIT_ALERT,
    ERRNUM_CRC,
    INST_PING,
    INST_REBOOT,
    GroupSyncWrite,
    PacketHandler,
)

from slot_core.dynamixel.packet import FAST_OVERHEAD, OVERHEAD
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import BusSettings
from slot_core.dynamixel.table import TABLE, decode_span, span
from slot_core.servos.servo_bus import ServoError

PROTOCOL = 2.0
# of a status packet without data: instruction, error and CRC
STATUS_BYTES = OVERHEAD + 4


class CommunicationError(ServoError):
    """No valid answer of a servo after all retries; the message has the SDK's text."""


class InstructionError(ServoError):
    """A servo answered with an error number (it has not executed the instruction).

    Also: a register holds another value than the one written.
    """


@dataclass(frozen=True)
class RegisterValues:
    """Values by register name; `alert`: the servo's hardware error status is not 0."""

    values: Mapping[str, int]
    alert: bool


@dataclass(frozen=True)
class _Status:
    """Error byte and data of a status packet."""

    error: int
    data: bytes

    @property
    def number(self) -> int:
        return self.error & ~ERRBIT_ALERT


class Bus:
    """All exchanges with the servos on one port; `names`: servo names for messages, by id."""

    def __init__(
        self,
        port: SerialPort,
        settings: BusSettings,
        names: Mapping[int, str] | None = None,
    ) -> None:
        self.port = port
        self._settings = settings
        self._handler: Any = PacketHandler(PROTOCOL)
        self._names = dict(names or {})
        self._silent: set[int] = set()
        self._failed: dict[int, deque[bool]] = defaultdict(
            lambda: deque(maxlen=settings.window)
        )

    def name(self, identity: int) -> str:
        """Name of a servo in messages."""
        return self._names.get(identity, f"servo id {identity}")

    def error_rate(self, identity: int) -> float:
        """Share of the last `window` exchanges with a servo that failed; 0 before the first."""
        failed = self._failed[identity]
        return sum(failed) / len(failed) if failed else 0.0

    def ping(self, identity: int) -> tuple[int, int]:
        """Model number and firmware version; raises CommunicationError, InstructionError."""
        data = self._exchange(
            identity, lambda: self._send(identity, INST_PING, 3), 3, "ping"
        )
        return data[0] | data[1] << 8, data[2]

    def scan(self) -> dict[int, tuple[int, int]]:
        """Model number and firmware version of every servo that answers, by id; takes about 1 s."""
        found, _ = self._handler.broadcastPing(self.port)
        return {
            identity: (model, firmware)
            for identity, (model, firmware) in found.items()
        }

    def read(
        self, identity: int, first: str, last: str | None = None
    ) -> dict[str, int]:
        """Values of the registers `first` to `last` (default: `first` alone), by name.

        Raises CommunicationError, InstructionError.
        """
        address, size = span(first, last or first)
        return decode_span(
            address,
            self._exchange(
                identity,
                lambda: self._handler.readTx(
                    self.port, identity, address, size
                ),
                size,
                f"reading {first}",
            ),
        )

    def write(self, identity: int, register: str, value: int) -> None:
        """Write one register; raises CommunicationError, InstructionError."""
        item = TABLE[register]
        self._exchange(
            identity,
            lambda: self._write(identity, item.address, item.encode(value)),
            0,
            f"writing {register} = {value}",
        )

    def write_verified(self, identity: int, register: str, value: int) -> None:
        """Write one register and read it back.

        Raises CommunicationError, and InstructionError also if the value read back differs.
        """
        self.write(identity, register, value)
        found = self.read(identity, register)[register]
        if found != value:
            raise InstructionError(
                f"{self.name(identity)}: {register} is {found} after {value} was written"
            )

    def reboot(self, identity: int) -> None:
        """Reboot a servo, which does not answer while it boots.

        Raises CommunicationError, InstructionError.
        """
        self._exchange(
            identity, lambda: self._send(identity, INST_REBOOT, 0), 0, "reboot"
        )

    def sync_write(self, register: str, values: Mapping[int, int]) -> None:
        """Write one register of several servos in one packet, values by id; without answers.

        Raises CommunicationError.
        """
        item = TABLE[register]
        group = GroupSyncWrite(
            self.port, self._handler, item.address, item.size
        )
        for identity, value in values.items():
            group.addParam(identity, list(item.encode(value)))
        result = group.txPacket()
        if result != COMM_SUCCESS:
            raise CommunicationError(
                f"writing {register} of all servos: {self._result_text(result)}"
            )

    def sync_read(
        self, ids: Iterable[int], first: str, last: str, fast: bool
    ) -> dict[int, RegisterValues]:
        """Valid answers by id, of the registers `first` to `last`.

        `fast`: use fast sync read, which all servos must support. A servo that does not answer is
        read alone, up to `retries` times. If it still does not answer, later calls ask it last and
        without retries until it answers, and use no fast sync read. A fast answer that fails
        counts as failed for all servos, since the servo at fault is unknown.
        """
        # stable
        order = sorted(ids, key=lambda identity: identity in self._silent)
        address, size = span(first, last)
        fast = fast and not self._silent.intersection(order)
        result = self._handler.syncReadTx(
            self.port, address, size, order, len(order), fast
        )
        receive = self._receive_fast if fast else self._receive_sound
        found = receive(order, size) if result == COMM_SUCCESS else {}
        for identity in order:
            self._failed[identity].append(identity not in found)
            if identity not in found and identity not in self._silent:
                found |= self._read_alone(identity, address, size)
        self._silent = (self._silent - set(order)) | (set(order) - set(found))
        return {
            identity: RegisterValues(
                decode_span(address, status.data),
                bool(status.error & ERRBIT_ALERT),
            )
            for identity, status in found.items()
        }

    def _receive_fast(self, ids: list[int], size: int) -> dict[int, _Status]:
        packet, result = self._handler.rxPacket(self.port, True)
        part_size = size + FAST_OVERHEAD
        length = 1 + len(ids) * part_size
        if (
            result != COMM_SUCCESS
            or packet[4] != BROADCAST_ID
            or _length(packet) != length
        ):
            self.port.drain(self._settings.quiet)
            return {}
        parts = [
            bytes(packet[8 + k * part_size :][: size + 2])
            for k in range(len(ids))
        ]
        return {
            part[1]: _Status(part[0], part[2:])
            for identity, part in zip(ids, parts)
            if part[1] == identity and not part[0] & ~ERRBIT_ALERT
        }

    def _receive_sound(self, ids: list[int], size: int) -> dict[int, _Status]:
        """Answers without an error number, by id."""
        found, _ = self._receive(ids, size)
        return {
            identity: status
            for identity, status in found.items()
            if not status.number
        }

    def _read_alone(
        self, identity: int, address: int, size: int
    ) -> dict[int, _Status]:
        for _ in range(self._settings.retries):
            self._handler.readTx(self.port, identity, address, size)
            found = self._receive_sound([identity], size)
            self._failed[identity].append(not found)
            if found:
                return found
        return {}

    def _exchange(
        self, identity: int, send: Callable[[], int], size: int, action: str
    ) -> bytes:
        """Send until an answer is valid, with at most `retries` retries; returns its data."""
        for _ in range(self._settings.retries + 1):
            found: dict[int, _Status] = {}
            result = send()
            if result == COMM_SUCCESS:
                found, result = self._receive([identity], size)
            self._failed[identity].append(identity not in found)
            status = found.get(identity)
            if status is not None and not status.number:
                return status.data
            cause = (
                self._result_text(result)
                if status is None
                else self._error_text(status.error)
            )
            # CRC: damaged on the line, retry
            if status is not None and status.number != ERRNUM_CRC:
                raise InstructionError(
                    f"{self.name(identity)}: {action}: {cause}"
                )
        raise CommunicationError(f"{self.name(identity)}: {action}: {cause}")

    def _send(self, identity: int, instruction: int, size: int) -> int:
        """Send an instruction without parameters, answered with `size` bytes of data."""
        packet = [0, 0, 0, 0, identity, 3, 0, instruction, 0, 0]
        result: int = self._handler.txPacket(self.port, packet)
        self.port.setPacketTimeout(STATUS_BYTES + size)
        return result

    def _write(self, identity: int, address: int, data: bytes) -> int:
        result: int = self._handler.writeTxOnly(
            self.port, identity, address, len(data), list(data)
        )
        self.port.setPacketTimeout(STATUS_BYTES)
        return result

    def _receive(
        self, ids: list[int], size: int
    ) -> tuple[dict[int, _Status], int]:
        """Status packets with `size` bytes of data by id; the SDK's result of the last packet."""
        found: dict[int, _Status] = {}
        result, invalid = COMM_SUCCESS, 0
        while len(found) < len(ids) and invalid <= len(ids):
            packet, result = self._handler.rxPacket(self.port, False)
            status = _status(packet, size) if result == COMM_SUCCESS else None
            if status is not None and packet[4] in ids:
                found[packet[4]] = status
                continue
            invalid += 1
            if result == COMM_SUCCESS:
                result = COMM_RX_CORRUPT
            elif self.port.packet_timeout == 0:
                # the SDK sets this on a timeout
                break
        if len(found) < len(ids):
            self.port.drain(self._settings.quiet)
        return found, result

    def _result_text(self, result: int) -> str:
        return str(self._handler.getTxRxResult(result))

    def _error_text(self, error: int) -> str:
        return str(self._handler.getRxPacketError(error & ~ERRBIT_ALERT))


def _length(packet: list[int]) -> int:
    return packet[5] | packet[6] << 8


def _status(packet: list[int], size: int) -> _Status | None:
    """Status of a packet of the SDK; None unless it has an error number or `size` bytes of data."""
    length = _length(packet)
    if length < 4 or len(packet) < length + OVERHEAD:
        return None
    status = _Status(packet[8], bytes(packet[9 : length + 5]))
    expected = 0 if status.number else size
    return status if len(status.data) == expected else None
