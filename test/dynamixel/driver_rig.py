"""Driver and emulated servos: in one process in simulated time, or behind a pseudo-terminal."""

from slot_core import config
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels, MemoryPort
from slot_core.dynamixel.emulator.pseudo_terminal import PseudoTerminal
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.faults import Fault

LATE = 0.01  # s, delay of an answer after which the driver has given it up
# Of the pseudo-terminal, longer than on the robot: a busy machine delays the emulator's thread.
LONG_TIMEOUT = {"bus.timeout": 1.0}
ONE_COUNT = 1.01 * RAD_PER_COUNT
STANDING = (0.1, 0.2, 0.3, 0.4)


class LateLine:
    """The emulated bus; answers that are late come before those to the next instruction."""

    def __init__(self, bus):
        self._bus, self._late = bus, []

    @property
    def unplugged(self):
        return self._bus.unplugged

    def receive(self, data, baud):
        replies = self._bus.receive(data, baud)
        passed = self._late + [reply for reply in replies if reply.delay < LATE]
        self._late = [reply for reply in replies if reply.delay >= LATE]
        return passed


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
        line = LateLine(self.bus)
        return MemoryPort(line, self.settings.bus.baud, lambda: self.time)

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
