"""Serial line to an emulated bus on a simulated clock, which only waiting for an answer advances.

Bytes take their time on the line, as behind the pseudo-terminal, but no thread has to send them: a
busy machine delays nothing.
"""

from collections import deque

from slot_core.dynamixel.port import BITS_PER_BYTE, SerialPort
from slot_core.emulator.pseudo_terminal import PACKET_GAP

RESOLUTION = 1e-6  # s, beyond a timeout


class Line:
    """The line, with the interface of `serial.Serial` that SerialPort uses."""

    is_open = True

    def __init__(self, bus, baud):
        self._bus, self._baud, self._byte = bus, baud, BITS_PER_BYTE / baud
        self.now = self._free = self._last = 0.0  # s
        self._coming = deque()  # (time of arrival, byte)

    @property
    def in_waiting(self):
        return sum(at <= self.now for at, _ in self._coming)

    def write(self, packet):
        if self.now - self._last > PACKET_GAP:
            self._bus.discard_partial()
        self._last = self.now
        at = max(self.now, self._free) + len(packet) * self._byte
        for reply in self._bus.receive(bytes(packet), self._baud):
            at += reply.delay
            for value in reply.data:
                at += self._byte
                self._coming.append((at, value))
        self._free = at
        return len(packet)

    def wait(self, timeout):
        """Wait for the next byte, at most `timeout` s."""
        end = self.now + timeout + RESOLUTION
        self.now = max(self.now, min(self._coming[0][0] if self._coming else end, end))

    def read(self, length):
        return bytes(self._coming.popleft()[1] for _ in range(min(length, self.in_waiting)))

    def reset_input_buffer(self):
        self.read(self.in_waiting)

    def close(self):
        pass


class LinePort(SerialPort):
    """The driver's port on such a line."""

    def __init__(self, bus, baud, timeout):
        self.line = Line(bus, baud)
        super().__init__("line", baud, timeout, lambda: self.line.now)

    def setupPort(self, cflag_baud):  # noqa: N802
        self.ser, self.is_open = self.line, True
        self.tx_time_per_byte = 1e3 * BITS_PER_BYTE / self.baudrate
        return True

    def _await(self, length, timeout):
        self.line.wait(timeout)
        return self.line.read(max(length, 0))
