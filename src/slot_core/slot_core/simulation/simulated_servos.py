"""Servos of the simulated robot: what lies between the commands of the graph and its tendons.

    DirectServos   follow every command at once: lockstep, where there is no supervisor
    GuardedServos  behind the command watchdog, as those of the robot are: real time
    BusServos      emulated on a bus; their commands come from the driver at its port

Times `now` are those of a clock that never goes back, ns.
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Protocol

import numpy as np

from slot_core.clock import SECOND
from slot_core.config import ConfigError
from slot_core.emulator.pseudo_terminal import PseudoTerminal
from slot_core.robot import LEGS, Array
from slot_core.safety.command_gate import Action
from slot_core.safety.command_watchdog import CommandWatchdog, Permission
from slot_core.safety.servo_health import ServoHealth, sound_servos
from slot_core.safety.settings import ServoLimits
from slot_core.simulation.bus_plant import BusPlant
from slot_core.simulation.plant import Plant

NO_LIMITS = "no limits of the supervisor yet"
OUTLAST = 3.0  # s for the driver to switch the servos off
BUS_SILENCE = 0.3  # s after which the driver has ended
PAUSE = 0.002  # s, between two steps meanwhile
THREAD_SWITCH = 5e-4  # s: how long the simulation keeps the bus from answering


class Servos(Protocol):
    """What the simulated robot needs of its servos."""

    @property
    def powered(self) -> bool:
        """Whether the servos are ready for commands, so that the sensors may report."""
        ...

    def offer(self, now: int, stamp: int, angle: Array) -> None:
        """Take a command (4,), rad; raises ValueError for one that is rejected."""
        ...

    def follows(self, now: int) -> bool:
        """Whether the servos follow commands, so that the simulation may start."""
        ...

    def step(self, now: int) -> ServoHealth | None:
        """Update the commands of the simulated robot; the servos' health where they report it."""
        ...

    @property
    def clock_jump(self) -> float:
        """Largest distance of a command's stamp from now, s."""
        ...

    def close(self, running: bool) -> str:
        """End; legs whose servos are still under torque. `running`: whether time passes."""
        ...


class DirectServos:
    """Servos that follow every command at once."""

    powered = True
    clock_jump = math.inf

    def __init__(self, plant: Plant) -> None:
        self._plant = plant

    def offer(self, now: int, stamp: int, angle: Array) -> None:
        """Take a command (4,), rad; raises ValueError for one out of range."""
        self._plant.command(angle)

    def follows(self, now: int) -> bool:
        """Always."""
        return True

    def step(self, now: int) -> None:
        """Nothing to update: a command holds until the next."""

    def close(self, running: bool) -> str:
        """Nothing to end."""
        return ""


class BusServos:
    """Emulated servos: commands of the graph reach them through the driver."""

    clock_jump = math.inf

    def __init__(self, plant: BusPlant, link: Path) -> None:
        """They answer at the pseudo-terminal `link`; raises ConfigError where a file is there."""
        if link.exists() and Path("/dev/pts") not in link.resolve().parents:
            raise ConfigError(f"sim_robot: bus = {link}: exists already")
        self._plant = plant
        sys.setswitchinterval(THREAD_SWITCH)
        self._terminal = PseudoTerminal(plant.legs.bus, link)

    @property
    def powered(self) -> bool:
        """Whether every servo is under torque."""
        return len(self._plant.powered()) == len(LEGS)

    def offer(self, now: int, stamp: int, angle: Array) -> None:
        """Check a command (4,), rad; raises ValueError for one out of range."""
        self._plant.command(angle)

    def follows(self, now: int) -> bool:
        """Whether every servo is under torque."""
        return self.powered

    def step(self, now: int) -> None:
        """Nothing to update: the bus moves the servos."""

    def close(self, running: bool) -> str:
        """Close the port once the driver has switched the servos off, or after three seconds."""
        last = time.monotonic()
        end = last + OUTLAST
        while self._terminal.silence < BUS_SILENCE and last < end:
            time.sleep(PAUSE)
            now = time.monotonic()
            if running:
                for _ in self._plant.advance(self._plant.now + round((now - last) * SECOND)):
                    pass  # no subscriber is left
            last = now
        self._terminal.close()
        return ", ".join(self._plant.powered())


class GuardedServos:
    """Servos behind the command watchdog, without a bus; they cannot fail.

    A servo without torque lets its tendon unwind as fast as it turns. Without the supervisor's
    limits no command is followed.
    """

    powered = True

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._watchdog: CommandWatchdog | None = None  # None: no limits yet
        self._torque = True

    @property
    def clock_jump(self) -> float:
        """Largest distance of a command's stamp from now, s; infinite without limits."""
        return math.inf if self._watchdog is None else self._watchdog.limits.clock_jump

    def set_limits(self, limits: ServoLimits) -> None:
        """Take the supervisor's limits; raises ConfigError as `CommandGate` does."""
        if self._watchdog is not None:
            self._watchdog.set_limits(limits)
            return
        high = self._plant.simulator.robot.tendon.angle_max
        self._watchdog = CommandWatchdog(limits, 0.0, high)
        self._watchdog.engage(_at(self._plant))

    def permit(self, permission: Permission) -> None:
        """Take the supervisor's newest permission."""
        if self._watchdog is not None:
            self._watchdog.permit(permission)

    def offer(self, now: int, stamp: int, angle: Array) -> None:
        """Take a command (4,), rad; raises ValueError for one that is rejected."""
        if self._watchdog is None:
            raise ValueError(NO_LIMITS)
        if fault := self._watchdog.offer(now, angle):
            raise ValueError(fault)

    def follows(self, now: int) -> bool:
        """Whether the watchdog lets commands pass."""
        if self._watchdog is None:
            return False
        self._watchdog.step(now)
        return self._watchdog.action is Action.PASS

    def step(self, now: int) -> ServoHealth:
        """Give the simulated servos what the watchdog lets pass."""
        watchdog = self._watchdog
        if watchdog is None:
            return sound_servos(Action.HOLD, NO_LIMITS, True, _at(self._plant))
        gated = watchdog.step(now)
        if gated.torque and not self._torque:
            watchdog.engage(_at(self._plant))
            gated = watchdog.step(now)
        self._torque = gated.torque
        self._plant.command(gated.angle if gated.torque else np.zeros(len(LEGS)))
        return sound_servos(
            watchdog.action, watchdog.reason, gated.torque, gated.angle, gated.slewed
        )

    def close(self, running: bool) -> str:
        """Nothing to end."""
        return ""


def _at(plant: Plant) -> Array:
    """(4,) rad, where the spools are."""
    return plant.simulator.tendon_angle
