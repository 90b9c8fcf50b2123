"""An emulated bus in the driver's own process: a port without a device.

Bytes take no time, so that a simulated clock may stand still during an exchange, and equal runs are
equal to the last bit.
"""

from __future__ import annotations

from slot_core.clock import Clock
from slot_core.dynamixel.port import SerialPort
from slot_core.emulator.emulated_bus import EmulatedBus


class MemoryPort(SerialPort):
    """Passes what is written to the bus, and hands out what the bus has answered."""

    def __init__(self, bus: EmulatedBus, baud: int, clock: Clock) -> None:
        super().__init__("memory", baud, 0.0, clock)
        self._bus = bus
        self._answers = bytearray()

    def open(self) -> None:
        """Nothing is there to be opened."""
        self.is_open = True

    def clearPort(self) -> None:  # noqa: N802
        """Drop the answers."""
        self._answers.clear()

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Up to `length` bytes of the answers."""
        wanted = max(length, 0)  # the SDK asks for less than nothing where a length is damaged
        data = bytes(self._answers[:wanted])
        del self._answers[:wanted]
        return data

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        """Let the bus answer; returns the number of bytes."""
        for reply in self._bus.receive(bytes(packet), self.baudrate):
            self._answers += reply.data
        return len(packet)

    def isPacketTimeout(self) -> bool:  # noqa: N802
        """Whether to wait no longer: answers are here at once or never."""
        if not self._answers:
            self.packet_timeout = 0.0
        return not self._answers

    def drain(self, quiet: float) -> int:
        """Drop the answers; returns how many bytes they were."""
        dropped = len(self._answers)
        self._answers.clear()
        return dropped
