"""Servos of the simulated robot, between the commands of the graph and the tendons.

    DirectServos  follow the watchdog, as the driver of real servos does
    BusServos     emulated servos on a bus: in lockstep behind driver and watchdog in this process,
                  in real time at a device, commanded by a driver in another process

In lockstep they are stepped on the robot's clock, which holds the robot in its starting pose until
its servos first follow a command. From then on a servo without torque moves as on a robot. In every
cycle the servos take the newest permission; in every second one they report, and the supervisor
steps on the report. Times `now`, ns, never go back.
"""

import sys
import time
from abc import ABC, abstractmethod
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import to_ns, to_seconds
from slot_core.dynamics.servo import read_servo
from slot_core.refusal import DivergenceError
from slot_core.robot import LEGS
from slot_core.safety.rate_limiter import AT_REST, unchanged
from slot_core.safety.states import Action
from slot_core.safety.supervisor import PERIOD
from slot_core.safety.watchdog import Permission, ServoHealth, Watchdog
from slot_core.servos.brand import EmulatedPort, EmulatedServos
from slot_core.servos.servo_bus import PortError, RefusedError
from slot_core.servos.session import ServoSession
from slot_core.simulation.plant import CYCLE, RobotSimulator
from slot_core.simulation.readings import Reading, StampedHealth

CYCLES = round(PERIOD / CYCLE)  # between two reports
CLOSE_TIMEOUT = 3.0  # s, for the driver to switch the servos off
CLOSE_STEP = 0.002  # s, between two steps of the simulation while closing
SWITCH_INTERVAL = 5e-4  # s, between thread switches: longest delay of the bus by the simulation


class SimulatedServos(ABC):
    """Servos of a simulated robot, and their cycles in lockstep.

    watchdog: of the servos; of those on a bus in real time it is in the driver, and this one has no
    limits. released: whether torque has gone off again, so that the tendons unwind.
    """

    def __init__(self, plant: RobotSimulator, lockstep: bool) -> None:
        self._plant, self._lockstep, self._number = plant, lockstep, 0
        plant.held = lockstep
        self.watchdog = Watchdog(plant.robot.parameters.tendon.angle_max)
        self.released = self._was_on = False
        # ns, stamp of the newest command and when it arrived
        self._commanded = self._arrived = 0

    @property
    @abstractmethod
    def action(self) -> Action:
        """Reaction of the servos to commands."""

    @property
    def moving(self) -> bool:
        """Whether the robot must not be held: its servos follow commands or are without torque."""
        return self.action is Action.PASS or self.released

    @property
    @abstractmethod
    def powered(self) -> bool:
        """Whether the servos accept commands; before that no readings are published."""

    @abstractmethod
    def offer(
        self, now: int, stamp: int, angle: Array, rate: Array = AT_REST
    ) -> None:
        """Take angles (4,), rad, at `now`, and their rate; raises ValueError if rejected."""

    @abstractmethod
    def health(self, stamp: int) -> ServoHealth | None:
        """Health report at `stamp` (ns); None: nobody reports any more."""

    @abstractmethod
    def _exchange(self) -> list[Reading]:
        """Pass commands to the servos in lockstep, and return their readings."""

    def permit(self, permission: Permission) -> None:
        """Set the newest permission of the supervisor."""
        self.watchdog.permit(permission)

    @abstractmethod
    def step(self, now: int) -> None:
        """Update the commands of the robot at `now`; those on a bus have them from their driver."""

    def close(self, running: bool) -> str:
        """End, and return the legs with torque still on; `running`: advance the robot meanwhile."""
        return ""

    def start(self) -> None:
        """Begin the cycles in lockstep; the robot's clock has started."""
        self._plant.timeline.every(CYCLE, self._cycle)

    def report(self) -> StampedHealth:
        """The health now, with the newest command, in lockstep."""
        now, found = self._plant.now, self.health(self._plant.now)
        if found is not None:
            found = ServoHealth(
                **vars(found)
                | {
                    "goal": found.goal.copy(),  # limited on in place
                    "slewed": found.slewed.copy(),
                    "commanded": self._commanded,
                    "written": self._arrived,
                }
            )
        return StampedHealth(now, found)

    def _cycle(self) -> list[Reading]:
        readings = self._exchange()
        self._number += 1
        return readings if self._number % CYCLES else [*readings, self.report()]

    def _note_torque(self, on: bool) -> None:
        """Note whether torque, once permitted, has gone off."""
        self._was_on = self._was_on or on
        self.released = self._was_on and not on

    def _unhold(self) -> None:
        """Let the robot move once it must not be held."""
        self._plant.held = self._plant.held and not self.moving


class DirectServos(SimulatedServos):
    """Servos behind the watchdog, without a bus; they have no faults.

    With torque off a servo turns to a slack tendon at its own speed. Until the limits of the
    supervisor are received, commands are rejected.
    """

    def __init__(self, plant: RobotSimulator, lockstep: bool = False) -> None:
        super().__init__(plant, lockstep)
        self.watchdog.engage(plant.robot.tendon_angle)
        self._goals = unchanged(Action.HOLD, plant.robot.tendon_angle, True)

    @property
    def action(self) -> Action:
        """Reaction of the servos to commands."""
        return self.watchdog.action

    @property
    def powered(self) -> bool:
        """Whether the servos accept commands: in lockstep with the limits of the supervisor."""
        return not self._lockstep or self.watchdog.limits is not None

    def offer(
        self, now: int, stamp: int, angle: Array, rate: Array = AT_REST
    ) -> None:
        """Take angles (4,), rad, at `now`, and their rate; raises ValueError if rejected."""
        self._commanded, self._arrived = stamp, now
        if fault := self.watchdog.offer(now, angle, rate):
            raise ValueError(fault)
        if self._lockstep:
            self.step(now)

    def step(self, now: int) -> None:
        """Command the simulated servos as the watchdog decides."""
        if self.watchdog.limits is None:
            return
        goals = self.watchdog.step(now)
        if goals.torque and not self._goals.torque:
            self.watchdog.engage(self._plant.robot.tendon_angle)
            goals = self.watchdog.step(now)
        self._goals = goals
        self._note_torque(goals.torque and self.watchdog.permission is not None)
        self._plant.command(
            goals.angle if goals.torque else np.zeros(len(LEGS))
        )

    @property
    def urgent(self) -> tuple[Any, ...]:
        """Values of the health report whose change is published at once."""
        return self.action, self._goals.torque, self._goals.slewed.tobytes()

    def health(self, stamp: int) -> ServoHealth:
        """Health report of the servos: they have no faults."""
        goals, voltage = self._goals, self._plant.robot.scene.supply_voltage
        return ServoHealth(
            self.action,
            self.watchdog.reason,
            np.full(len(LEGS), goals.torque),
            goals.angle,
            goals.slewed,
            voltage=np.full(len(LEGS), voltage),
            supervised=self.watchdog.supervised,
        )

    def _exchange(self) -> list[Reading]:
        self.step(self._plant.now)
        self._unhold()
        return []


class BusServos(SimulatedServos):
    """Emulated servos on a bus, behind their driver and its watchdog.

    In lockstep exchanges take no time, and a driver whose port disappears ends, as the node does.
    One that has ended neither reads nor writes nor reports.
    """

    session: ServoSession  # driver and watchdog, in lockstep
    _port: EmulatedPort  # for the driver in another process, in real time

    def __init__(
        self,
        plant: RobotSimulator,
        lockstep: bool = False,
        link: Path | None = None,
    ) -> None:
        """In lockstep check every servo, else open a device under the name `link`.

        Raises RefusedError, or ConfigError if another file has the name of the link.
        """
        super().__init__(plant, lockstep)
        assert plant.emulated is not None
        self._servos: EmulatedServos = plant.emulated
        self._model = read_servo()
        self.end = ""  # why the driver has ended, in lockstep
        if lockstep:
            self.session = ServoSession(
                self._servos.connect(lambda: to_seconds(plant.now)),
                plant.robot.parameters.tendon.angle_max,
                CYCLE,
                self._pass,
            )
            self.watchdog = self.session.watchdog
            self.session.configure()
        else:
            sys.setswitchinterval(SWITCH_INTERVAL)
            self._port = self._servos.serve(link)

    @property
    def action(self) -> Action:
        """Reaction of the servos to commands: in real time HOLD until the driver moves one."""
        if self._lockstep:
            return self.session.action
        return Action.PASS if self._servos.driven() else Action.HOLD

    @property
    def powered(self) -> bool:
        """Whether the servos accept commands: every torque is on, in lockstep may come on."""
        return (
            self.watchdog.limits is not None
            if self._lockstep
            else len(self._servos.powered()) == len(LEGS)
        )

    def permit(self, permission: Permission) -> None:
        """Set the newest permission, in lockstep; it switches torque on or off at once."""
        if self.end:
            return
        self.session.permit(permission)
        if self.session.may_start(permission):
            with suppress(RefusedError):  # the session reports it
                self.session.start()

    def offer(
        self, now: int, stamp: int, angle: Array, rate: Array = AT_REST
    ) -> None:
        """Take angles (4,), rad, their rate, and a bus cycle, in lockstep; else the driver does.

        Raises ValueError if they are rejected.
        """
        self._commanded, self._arrived = stamp, now
        if self.end:
            return
        if fault := self.session.offer(now, stamp, angle, rate):
            raise ValueError(fault)
        self._exchange()

    def step(self, now: int) -> None:
        """Note the torque, in real time."""
        if not self._lockstep:
            self._note_torque(self.powered)

    def health(self, stamp: int) -> ServoHealth | None:
        """Health report in lockstep, unless the driver has ended."""
        return None if self.end else self.session.health(stamp)

    def close(self, running: bool) -> str:
        """Slacken the tendons, torque off; return the legs with torque still on.

        In real time the driver does so until it closes the device, at the latest in CLOSE_TIMEOUT.
        """
        if not self._lockstep:
            self._await_driver(running)
        elif not self.end:
            self.end = "closed"  # no further cycles but those of the ramp
            if running:
                with suppress(DivergenceError):  # of the ramp; torque is off
                    self.session.stop()
            else:
                self.session.bus.torque_off()
        return ", ".join(self._servos.powered())

    def _await_driver(self, running: bool) -> None:
        """Advance the robot until the driver has closed the device, then remove it."""
        self._port.release()
        last = time.monotonic()
        end = last + CLOSE_TIMEOUT
        while self._port.in_use and last < end:
            time.sleep(CLOSE_STEP)
            now = time.monotonic()
            if running:
                try:
                    self._pass(now - last)
                except DivergenceError:  # the device is removed all the same
                    running = False
            last = now
        self._port.close()

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
        self._note_torque(self.session.bus.active)
        self._unhold()
        reading = cycle.joints(
            now, self._model.tendon_stall(self.session.voltage)
        )
        return [] if reading is None else [reading]

    def _pass(self, seconds: float) -> None:
        """Let time pass on the robot's clock; nothing receives the readings."""
        deque(self._plant.advance(self._plant.now + to_ns(seconds)), maxlen=0)


def make_servos(
    plant: RobotSimulator, lockstep: bool, link: Path | None = None
) -> SimulatedServos:
    """The servos of a plant; raises RefusedError, ConfigError as `BusServos`."""
    return (
        DirectServos(plant, lockstep)
        if plant.emulated is None
        else BusServos(plant, lockstep, link)
    )
