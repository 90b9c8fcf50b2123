"""Packets of Protocol 2.0: byte stuffing, packet builder, stream parser; the SDK has CRC and numbers.

    FF FF FD 00 | id | length (2) | instruction | parameters | CRC (2)

`length` is the number of bytes after it. Byte stuffing: an FF FF FD between the length and the CRC
is followed by another FD. CRC: CRC-16 with the polynomial x^16 + x^15 + x^2 + 1, most significant
bit first, initial value 0, over all bytes before it. A status packet has instruction 0x55 and an
error byte before its parameters. Source: ROBOTIS e-manual, Protocol 2.0.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import dynamixel_sdk as sdk

HEADER = b"\xff\xff\xfd\x00"
PACKET_MAX = 1024  # bytes of the longest packet accepted, as in dynamixel-sdk
LENGTH_MIN = 3  # value of `length` without parameters: instruction and CRC
OVERHEAD = 7  # bytes from the header to the length, both included
# bytes of each servo in a fast answer beside its data: error, id, CRC
FAST_OVERHEAD = 4
PLAIN, STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"


@dataclass(frozen=True)
class Packet:
    """A received packet, unstuffed; `intact`: its CRC matched."""

    id: int
    instruction: int
    parameters: bytes
    intact: bool = True


_SDK = sdk.PacketHandler(2.0)


def crc(data: bytes) -> int:
    """CRC of `data`."""
    return int(_SDK.updateCRC(0, data, len(data)))


def build(identity: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Bytes on the wire of a packet."""
    body = (bytes([instruction]) + parameters).replace(PLAIN, STUFFED)
    length = (len(body) + 2).to_bytes(2, "little")
    return _with_crc(HEADER + bytes([identity]) + length + body)


def status(identity: int, error: int, parameters: bytes = b"") -> bytes:
    """Bytes on the wire of a status packet."""
    return build(identity, sdk.INST_STATUS, bytes([error]) + parameters)


def _with_crc(data: bytes) -> bytes:
    return data + crc(data).to_bytes(2, "little")


def fast_status(replies: list[tuple[int, int, bytes]]) -> bytes:
    """Status packet shared by several servos, the answer to a fast read, from (id, error, data).

    Each servo appends its error, id, data and the CRC of all bytes so far; no byte stuffing.
    """
    length = 1 + sum(len(data) + FAST_OVERHEAD for _, _, data in replies)
    packet = HEADER + bytes([sdk.BROADCAST_ID]) + length.to_bytes(2, "little")
    packet += bytes([sdk.INST_STATUS])
    for identity, error, data in replies:
        packet = _with_crc(packet + bytes([error, identity]) + data)
    return packet


class Parser:
    """Parser of packets in a stream of bytes; bytes that belong to no packet are skipped."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def reset(self) -> None:
        """Discard an incomplete packet."""
        self._buffer.clear()

    def feed(self, data: bytes) -> Iterator[Packet]:
        """Packets that `data` completes, in their order.

        A packet with a wrong CRC comes with `intact` false; the search goes on at its second byte.
        """
        self._buffer += data
        while (packet := self._next()) is not None:
            yield packet

    def _next(self) -> Packet | None:
        buffer = self._buffer
        while self._align():
            length = int.from_bytes(buffer[5:7], "little")
            if (
                not LENGTH_MIN <= length <= PACKET_MAX - OVERHEAD
                or buffer[4] > sdk.BROADCAST_ID
            ):
                del buffer[:1]  # no packet begins here
                continue
            if len(buffer) < length + OVERHEAD:
                return None
            data = bytes(buffer[: length + OVERHEAD])
            intact = crc(data[:-2]) == int.from_bytes(data[-2:], "little")
            del buffer[: len(data) if intact else 1]
            parameters = data[8:-2].replace(STUFFED, PLAIN)
            return Packet(data[4], data[7], parameters, intact)
        return None

    def _align(self) -> bool:
        """Drop the bytes before the next header; returns whether id and length are there."""
        start = self._buffer.find(HEADER)
        if start < 0:
            start = max(len(self._buffer) - len(HEADER) + 1, 0)
            while start < len(self._buffer) and not HEADER.startswith(
                self._buffer[start:]
            ):
                start += 1
        del self._buffer[:start]
        return len(self._buffer) >= OVERHEAD
