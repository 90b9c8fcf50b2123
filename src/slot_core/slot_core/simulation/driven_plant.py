"""The simulated robot with the real driver: driver, bus and servos run on the robot's clock."""

from __future__ import annotations

import numpy as np

from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.settings import DynamixelSettings
from slot_core.emulator.emulated_bus import EmulatorSettings
from slot_core.emulator.memory_port import MemoryPort
from slot_core.robot import Array, Robot
from slot_core.safety.command_gate import AT_REST
from slot_core.simulation.bus_plant import BusPlant
from slot_core.simulation.plant import Reading


class DrivenPlant(BusPlant):
    """Simulated robot whose commands go through driver and bus, as with `--hardware fake_bus`.

    A bus cycle runs every period and on every command; it takes no time. Between commands the goals
    go on at the command's rate.
    """

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        servo: ServoSettings,
        rng: np.random.Generator,
        *,
        settings: DynamixelSettings,
        emulator: EmulatorSettings,
        period: float,
    ) -> None:
        """Start with torque on at the settled tendon angles; `period` (s) of the bus cycles."""
        super().__init__(robot, scene, servo, rng, settings=settings, emulator=emulator)
        port = MemoryPort(self.legs.bus, settings.bus.baud, self._seconds)
        self.driver = Driver(port, settings, self._seconds)
        self.driver.configure()
        self.driver.activate()
        self._period = period

    def start(self, stamp: int) -> None:
        """Begin at `stamp` (ns); the first bus cycle is due one period later."""
        super().start(stamp)
        self.every(self._period, self._cycle)

    def command(self, angle: Array, rate: Array = AT_REST) -> None:
        """Pass tendon angles (4,), rad, and their rate (4,), rad/s, on; raises ValueError."""
        super().command(angle, rate)
        self._cycle()

    def _cycle(self) -> list[Reading]:
        self.driver.command(self.commanded())
        self.driver.cycle()
        return []

    def _seconds(self) -> float:
        return self.now * 1e-9
