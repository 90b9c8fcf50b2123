"""Port to an emulated bus in the same process, without a device.

Transmission takes no time: a simulated clock may stand still during an exchange, and equal runs are
equal to the last bit.
"""

from __future__ import annotations

from slot_core.clock import Clock
from slot_core.dynamixel.emulator.emulated_bus import EmulatedBus
from slot_core.dynamixel.port import SerialPort
from slot_core.servos.servo_errors import PortError


class MemoryPort(SerialPort):
    """Port that passes packets to the bus and buffers the bus's answers."""

    def __init__(self, bus: EmulatedBus, baud: int, clock: Clock) -> None:
        super().__init__("memory", baud, 0.0, clock)
        self._bus = bus
        self._answers = bytearray()

    def open(self) -> None:
        """Mark the port as open; there is no device."""
        self.is_open = True

    def clearPort(self) -> None:  # noqa: N802
        """Discard the answers."""
        self._answers.clear()

    def readPort(self, length: int) -> bytes:  # noqa: N802
        """Up to `length` bytes of the answers."""
        size = max(length, 0)  # negative after a corrupted length field
        data = bytes(self._answers[:size])
        del self._answers[:size]
        return data

    def writePort(self, packet: list[int]) -> int:  # noqa: N802
        """Pass a packet to the bus and buffer the answers; returns the number of bytes sent.

        Raises PortError while the bus is unplugged.
        """
        if self._bus.unplugged:
            raise PortError(f"{self.port_name}: the port has disappeared")
        for reply in self._bus.receive(bytes(packet), self.baudrate):
            self._answers += reply.data
        return len(packet)

    def isPacketTimeout(self) -> bool:  # noqa: N802
        """True if the receive buffer is empty; the emulated bus answers immediately."""
        if not self._answers:
            self.packet_timeout = 0.0
        return not self._answers

    def drain(self, quiet: float) -> int:
        """Discard the answers; returns the number of bytes discarded."""
        dropped = len(self._answers)
        self._answers.clear()
        return dropped
