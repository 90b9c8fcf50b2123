"""Servos of the simulated robot in real time, between the commands of the graph and the tendons.

    GuardedServos  follow the command watchdog, as the driver of real servos does
    BusServos      emulated servos on a bus, commanded by the driver at its port

Times `now` are those of a clock that never goes back, ns.
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from slot_core.clock import to_ns
from slot_core.divergence import DivergenceError
from slot_core.emulator.pseudo_terminal import PseudoTerminal
from slot_core.robot import LEGS, Array
from slot_core.safety.command_gate import AT_REST, Action
from slot_core.safety.command_guard import NO_LIMITS, CommandGuard
from slot_core.safety.command_watchdog import Permission
from slot_core.safety.servo_health import ServoHealth, healthy_servos
from slot_core.safety.settings import ServoLimits
from slot_core.simulation.bus_plant import BusPlant
from slot_core.simulation.plant import Plant

CLOSE_TIMEOUT = 3.0  # s, for the driver to switch the servos off
CLOSE_STEP = 0.002  # s, between two steps of the simulation while closing
SWITCH_INTERVAL = 5e-4  # s, between thread switches: longest delay of the bus by the simulation


class Servos(Protocol):
    """Interface of the servos.

    released: whether torque has gone off again, so that the tendons unwind without a command.
    """

    released: bool

    @property
    def powered(self) -> bool:
        """Whether the servos accept commands; before that no readings are published."""
        ...

    def offer(self, now: int, stamp: int, angle: Array, rate: Array = AT_REST) -> None:
        """Take angles (4,), rad, at `now`, and their rate; raises ValueError if rejected."""
        ...

    def follows(self, now: int) -> bool:
        """Whether the servos follow commands at `now`; before that the robot stays frozen."""
        ...

    def step(self, now: int) -> None:
        """Update the commands of the robot at `now`."""
        ...

    @property
    def clock_jump(self) -> float:
        """Largest difference between the stamp of a command and the present, s."""
        ...

    def close(self, running: bool) -> str:
        """End, and return the legs with torque still on; `running`: advance the robot meanwhile."""
        ...


class BusServos:
    """Emulated servos, which take the commands of the graph through the driver."""

    released = False
    clock_jump = math.inf

    def __init__(self, plant: BusPlant, link: Path) -> None:
        """Open the pseudo-terminal `link`; raises ConfigError if another file has that name."""
        self._plant = plant
        sys.setswitchinterval(SWITCH_INTERVAL)
        self._terminal = PseudoTerminal(plant.legs.bus, link)

    @property
    def powered(self) -> bool:
        """Whether every servo has torque on."""
        return len(self._plant.powered()) == len(LEGS)

    def offer(self, now: int, stamp: int, angle: Array, rate: Array = AT_REST) -> None:
        """Check the range of a command (4,), rad; raises ValueError."""
        self._plant.command(angle)

    def follows(self, now: int) -> bool:
        """Whether every servo has torque on."""
        return self.powered

    def step(self, now: int) -> None:
        """Do nothing: the servos are commanded over the bus."""

    def close(self, running: bool) -> str:
        """Close the port when the driver has closed it, at the latest after CLOSE_TIMEOUT."""
        self._terminal.release()
        last = time.monotonic()
        end = last + CLOSE_TIMEOUT
        while self._terminal.in_use and last < end:
            time.sleep(CLOSE_STEP)
            now = time.monotonic()
            if running:
                try:
                    for _ in self._plant.advance(self._plant.now + to_ns(now - last)):
                        pass  # no subscriber is left
                except DivergenceError:  # the port is closed all the same
                    running = False
            last = now
        self._terminal.close()
        return ", ".join(self._plant.powered())


class GuardedServos:
    """Servos behind the command watchdog, without a bus; they have no faults of their own.

    With torque off a servo turns to a slack tendon at its own speed. Until the limits of the
    supervisor are received, commands are rejected.
    """

    powered = True

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._guard = CommandGuard(0.0, plant.simulator.robot.tendon.angle_max)
        self.action, self.reason = Action.HOLD, NO_LIMITS
        self._goal = _spool_angles(plant)  # (4,) rad
        self._slewed = np.zeros(len(LEGS), dtype=bool)
        self._torque = True
        self._permitted = False  # whether the supervisor has ever permitted torque
        self._was_on = False  # torque, by permission
        self.released = False

    @property
    def clock_jump(self) -> float:
        """Largest difference between a command's stamp and the present, s; inf without limits."""
        return self._guard.clock_jump

    def set_limits(self, limits: ServoLimits) -> None:
        """Set the limits of the supervisor; raises ConfigError as `CommandGate` does."""
        first = self._guard.watchdog is None
        self._guard.set_limits(limits)
        if first and self._guard.watchdog:
            self._guard.watchdog.engage(_spool_angles(self._plant))

    def permit(self, permission: Permission) -> None:
        """Set the newest permission of the supervisor."""
        self._guard.permit(permission)
        if self._guard.watchdog is not None:
            self._permitted = self._permitted or permission.action is not Action.OFF

    def offer(self, now: int, stamp: int, angle: Array, rate: Array = AT_REST) -> None:
        """Take angles (4,), rad, at `now`, and their rate; raises ValueError if rejected."""
        if fault := self._guard.offer(now, angle, rate):
            raise ValueError(fault)

    def follows(self, now: int) -> bool:
        """Whether the action of the watchdog is PASS."""
        watchdog = self._guard.watchdog
        if watchdog is None:
            return False
        watchdog.step(now)
        return watchdog.action is Action.PASS

    def step(self, now: int) -> None:
        """Command the simulated servos as the watchdog decides."""
        watchdog = self._guard.watchdog
        if watchdog is None:
            return
        gated = watchdog.step(now)
        if gated.torque and not self._torque:
            watchdog.engage(_spool_angles(self._plant))
            gated = watchdog.step(now)
        self.action, self.reason = watchdog.action, watchdog.reason
        self._goal, self._slewed, self._torque = gated.angle, gated.slewed, gated.torque
        self._was_on = self._was_on or (self._permitted and gated.torque)
        self.released = self._was_on and not gated.torque
        self._plant.command(gated.angle if gated.torque else np.zeros(len(LEGS)))

    @property
    def urgent(self) -> tuple[Any, ...]:
        """Values of the health report whose change is published at once."""
        return self.action, self._torque, self._slewed.tobytes()

    def health(self, stamp: int) -> ServoHealth:
        """Health report of the servos: they have no faults."""
        return healthy_servos(
            self.action,
            self.reason,
            self._torque,
            self._goal,
            self._slewed,
            voltage=self._plant.simulator.scene.supply_voltage,
        )

    def close(self, running: bool) -> str:
        """Return "": there is nothing to end."""
        return ""


def _spool_angles(plant: Plant) -> Array:
    """Angles of the spools (4,), rad."""
    return plant.simulator.tendon_angle
