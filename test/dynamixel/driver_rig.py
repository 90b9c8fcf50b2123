"""Driver and emulated servos in one process, in simulated time."""

from slot_core import config
from slot_core.dynamixel.emulator.emulated_bus import read_emulator
from slot_core.dynamixel.emulator.emulated_legs import EmulatedDynamixels
from slot_core.dynamixel.settings import read_settings
from slot_core.dynamixel.table import RAD_PER_COUNT
from slot_core.faults import Fault

ONE_COUNT = 1.01 * RAD_PER_COUNT
STANDING = (0.1, 0.2, 0.3, 0.4)
PERIOD = 0.01  # s, of the driver's cycles


class DriverRig:
    """Driver and emulated servos; their time passes only in `run`."""

    def __init__(self, changes=(), angles=STANDING):
        settings = config.replace(read_settings(), dict(changes))
        self.legs = EmulatedDynamixels(settings, read_emulator(), angles)
        self.bus, self.time = self.legs.bus, 0.0
        self.connect()

    def connect(self):
        """A driver that knows nothing of another before it."""
        self.driver = self.legs.connect(lambda: self.time)

    def start(self):
        self.driver.configure()
        self.driver.activate()
        return self

    def run(self, duration, goals=None, torques=(0.0,) * 4):
        """Cycles of the driver, between which the servos move; returns all cycles."""
        cycles = []
        for _ in range(round(duration / PERIOD)):
            if goals is not None:
                self.driver.command(goals)
            cycles.append(self.driver.cycle())
            self.legs.advance(PERIOD, torques)
            self.time += PERIOD
        return cycles

    def fault(self, kind, leg="FL", value=0.0):
        self.bus.set_fault(Fault(kind, leg, 0.0, 0.0, value), True)

    def torque(self):
        return [servo.memory["torque_enable"] for servo in self.bus.servos]
