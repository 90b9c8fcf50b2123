"""Driver and emulated servos: on a serial line in simulated time, or behind a pseudo-terminal.

Bytes take their time on the simulated line, as behind the pseudo-terminal, but no thread has to
send them: a busy machine delays nothing. Only waiting for an answer advances its clock.
"""

from collections import deque

from slot_core import config
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels
from slot_core.dynamixel.emulator.pseudo_terminal import PACKET_GAP, PseudoTerminal
from slot_core.dynamixel.port import BITS_PER_BYTE, SerialPort
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.faults import Fault

RESOLUTION = 1e-6  # s, beyond a timeout
# Of the pseudo-terminal, longer than on the robot: a busy machine delays the emulator's thread.
LONG_TIMEOUT = {"bus.timeout": 1.0}
ONE_COUNT = 1.01 * RAD_PER_COUNT
STANDING = (0.1, 0.2, 0.3, 0.4)


class SerialLine:
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
        return bytes(
            self._coming.popleft()[1] for _ in range(min(length, self.in_waiting))
        )

    def reset_input_buffer(self):
        self.read(self.in_waiting)

    def close(self):
        pass


class LinePort(SerialPort):
    """The driver's port on such a line."""

    def __init__(self, bus, baud, timeout):
        self.line = SerialLine(bus, baud)
        super().__init__("line", baud, timeout, lambda: self.line.now)

    def setupPort(self, cflag_baud):  # noqa: N802
        self.ser, self.is_open = self.line, True
        self.tx_time_per_byte = 1e3 * BITS_PER_BYTE / self.baudrate
        return True

    def _await(self, length, timeout):
        self.line.wait(timeout)
        return self.line.read(max(length, 0))


class DriverRig:
    """Driver and emulated servos; their time passes only in `run`."""

    def __init__(self, changes=(), emulator=(), angles=STANDING):
        self.settings = config.replace(read_settings(), dict(changes))
        self.legs = EmulatedDynamixels(
            self.settings, config.replace(read_emulator(), dict(emulator)), angles
        )
        self.bus, self.time = self.legs.bus, 0.0
        self.new_driver()

    def new_driver(self):
        """A driver that knows nothing of another before it."""
        self.driver = Driver(self.port(), self.settings, clock=lambda: self.time)

    def port(self):
        return LinePort(self.bus, self.settings.bus.baud, self.settings.bus.timeout)

    def start(self):
        self.driver.configure()
        self.driver.activate()
        return self

    def run(self, duration, goals=None, torques=(0.0,) * 4, period=0.01):
        """Cycles of the driver, between which the servos move; returns all cycles."""
        cycles = []
        for _ in range(round(duration / period)):
            if goals is not None:
                self.driver.command(goals)
            cycles.append(self.driver.cycle())
            self.legs.advance(period, torques)
            self.time += period
        return cycles

    def fault(self, kind, leg="FL", value=0.0):
        self.bus.inject(Fault(kind, leg, 0.0, 0.0, value))

    def torque(self):
        return [servo.memory["torque_enable"] for servo in self.bus.servos]

    def faults(self):
        return [
            line for servo in self.driver.health for line in servo.faults(armed=True)
        ]

    def close(self):
        self.driver.close()


class TerminalRig(DriverRig):
    """The same behind a pseudo-terminal, which takes real time."""

    def __init__(self, link=None):
        self._link = link
        super().__init__(LONG_TIMEOUT)

    def port(self):
        self.terminal = PseudoTerminal(self.bus, self._link)
        return SerialPort(
            self.terminal.name, self.settings.bus.baud, self.settings.bus.timeout
        )

    def close(self):
        super().close()
        self.terminal.close()
