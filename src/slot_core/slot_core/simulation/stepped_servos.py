"""Servos stepped on the robot's clock, with the supervisor: simulated ones, and driver and bus.

The robot is held in its starting pose until its servos first follow a command. From then on a
servo without torque moves as on a robot. In every cycle the servos take the newest permission; in
every second one they report, and the supervisor steps on the report.
"""

from __future__ import annotations

import dataclasses
from collections import deque
from contextlib import suppress

from slot_core.clock import to_ns, to_seconds
from slot_core.divergence import DivergenceError
from slot_core.dynamics.servo import read_servo
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.errors import PortError, RefusedError
from slot_core.dynamixel.session import ServoSession, measured
from slot_core.dynamixel.settings import read_settings
from slot_core.emulator.memory_port import MemoryPort
from slot_core.robot import Array
from slot_core.safety.command_gate import AT_REST, Action
from slot_core.safety.command_watchdog import Permission
from slot_core.safety.servo_health import ServoHealth
from slot_core.safety.settings import ServoLimits
from slot_core.safety.supervisor import PERIOD
from slot_core.simulation.bus_plant import BusPlant
from slot_core.simulation.plant import CYCLE, Plant, Reading, ServoReport
from slot_core.simulation.simulated_servos import GuardedServos

CYCLES = round(PERIOD / CYCLE)  # between two reports


class SteppedServos(GuardedServos):
    """Simulated servos behind the command watchdog, on the robot's clock."""

    def __init__(self, plant: Plant) -> None:
        super().__init__(plant)
        plant.held, self.powered = True, False
        self._number = 0  # of the cycle
        self.commanded = self.written = 0  # ns, stamp of the newest command and when it arrived

    def set_limits(self, limits: ServoLimits) -> None:
        """Set the limits of the supervisor, from which on commands are accepted."""
        super().set_limits(limits)
        self.powered = True

    def start(self) -> None:
        """Begin the cycles; the robot's clock has started."""
        self._plant.every(CYCLE, self._cycle)

    def offer(self, now: int, stamp: int, angle: Array, rate: Array = AT_REST) -> None:
        """Take angles (4,), rad, and their rate, and step; raises ValueError if rejected."""
        self.commanded, self.written = stamp, now
        super().offer(now, stamp, angle, rate)
        self.step(now)

    def report(self) -> ServoReport:
        """The health now."""
        return ServoReport(self._plant.now, self.health(self._plant.now))

    def _cycle(self) -> list[Reading]:
        self.step(self._plant.now)
        follows = self.action is Action.PASS
        self._plant.held = self._plant.held and not (follows or self.released)
        self._number += 1
        return [] if self._number % CYCLES else [self.report()]

    def health(self, stamp: int) -> ServoHealth:
        """Health report, with the newest command."""
        return dataclasses.replace(
            super().health(stamp), commanded=self.commanded, written=self.written
        )


class DrivenServos:
    """Emulated servos behind driver and bus, on the robot's clock; exchanges take no time.

    A driver whose port disappears ends, as the node does. One that has ended neither reads nor
    writes nor reports.
    """

    def __init__(self, plant: BusPlant) -> None:
        """Check every servo; raises RefusedError."""
        self._plant, self._number, settings = plant, 0, read_settings()
        port = MemoryPort(plant.legs.bus, settings.bus.baud, self._seconds)
        driver = Driver(port, settings, self._seconds)
        angle_max = plant.simulator.robot.tendon.angle_max
        self.session = ServoSession(driver, angle_max, CYCLE, self._pass)
        self._servo = read_servo()
        self.powered = self.released = self._was_on = False
        self.end = ""  # why the driver has ended
        self._commanded = self._arrived = 0  # ns, stamp of the newest command and when it arrived
        plant.held = True
        self.session.configure()

    @property
    def action(self) -> Action:
        """What the servos do with commands."""
        return self.session.action

    @property
    def clock_jump(self) -> float:
        """Largest difference between a command's stamp and the present, s; inf without limits."""
        return self.session.clock_jump

    def set_limits(self, limits: ServoLimits) -> None:
        """Set the limits of the supervisor; raises ConfigError as `CommandGate` does."""
        self.session.set_limits(limits)
        self.powered = True

    def start(self) -> None:
        """Begin the cycles; the robot's clock has started."""
        self._plant.every(CYCLE, self._cycle)

    def permit(self, permission: Permission) -> None:
        """Set the newest permission of the supervisor; it switches torque on or off at once."""
        if self.end:
            return
        self.session.permit(permission)
        if self.session.may_start(permission):
            try:
                self.session.start()
            except RefusedError:
                return  # the session reports it

    def offer(self, now: int, stamp: int, angle: Array, rate: Array = AT_REST) -> None:
        """Take angles (4,), rad, their rate, and a bus cycle; raises ValueError if rejected."""
        self._commanded, self._arrived = stamp, now
        if self.end:
            return
        if fault := self.session.offer(now, stamp, angle, rate):
            raise ValueError(fault)
        self._exchange()

    def report(self) -> ServoReport:
        """The health now, with the newest command, unless the driver has ended."""
        now = self._plant.now
        if self.end:
            return ServoReport(now, None)
        health = dataclasses.replace(
            self.session.health(now), commanded=self._commanded, written=self._arrived
        )
        return ServoReport(now, health)

    def follows(self, now: int) -> bool:
        """Whether the servos follow commands."""
        return self.action is Action.PASS

    def step(self, now: int) -> None:
        """Do nothing: a bus cycle follows on every command and on the robot's clock."""

    def close(self, running: bool) -> str:
        """Slacken the tendons, torque off; return the legs with torque still on."""
        if not self.end:
            self.end = "closed"  # no further cycles but those of the ramp
            if running:
                with suppress(DivergenceError):  # of the ramp; torque is off
                    self.session.stop()
            else:
                self.session.driver.torque_off()
        return ", ".join(self._plant.powered())

    def _cycle(self) -> list[Reading]:
        readings = self._exchange()
        self._number += 1
        return readings if self._number % CYCLES else [*readings, self.report()]

    def _exchange(self) -> list[Reading]:
        """A bus cycle; the joints if every servo has answered."""
        if self.end:
            return []
        now = self._plant.now
        try:
            cycle = self.session.step(now)
        except PortError as error:
            self.end = str(error)
            return []
        on = self.session.driver.active
        self._was_on = self._was_on or on
        self.released = self._was_on and not on
        follows = self.action is Action.PASS
        self._plant.held = self._plant.held and not (follows or self.released)
        reading = measured(now, cycle, self._servo.tendon_stall(self.session.voltage))
        return [] if reading is None else [reading]

    def _pass(self, seconds: float) -> None:
        """Let time pass on the robot's clock; nothing receives the readings."""
        deque(self._plant.advance(self._plant.now + to_ns(seconds)), maxlen=0)

    def _seconds(self) -> float:
        return to_seconds(self._plant.now)


def stepped(plant: Plant) -> SteppedServos | DrivenServos:
    """The servos of a plant on the robot's clock: those of a bus behind the driver."""
    return DrivenServos(plant) if isinstance(plant, BusPlant) else SteppedServos(plant)
