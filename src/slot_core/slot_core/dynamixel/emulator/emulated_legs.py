"""Emulated servos that wind the tendons of a simulated robot, in angles of the tendons.

A driver in the same process reaches them without a device. Transmission then takes no time: a
simulated clock may stand still during an exchange, and equal runs are equal to the last bit.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from slot_core.arrays import Array
from slot_core.clock import Clock
from slot_core.dynamixel.checks import expected
from slot_core.dynamixel.driver import Driver
from slot_core.dynamixel.emulator.emulated_bus import (
    EmulatedBus,
    EmulatorSettings,
)
from slot_core.dynamixel.emulator.pseudo_terminal import PseudoTerminal
from slot_core.dynamixel.port import SerialPort
from slot_core.dynamixel.settings import DynamixelSettings, joints
from slot_core.faults import Fault
from slot_core.robot import LEGS
from slot_core.servos.servo_bus import PortError


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

    def drain(self, quiet: float) -> None:
        """Discard the answers."""
        self._answers.clear()


class EmulatedDynamixels:
    """Bus of emulated servos with the registers of `settings`; implements `EmulatedServos`."""

    def __init__(
        self,
        settings: DynamixelSettings,
        emulator: EmulatorSettings,
        angles: Sequence[float] | Array = (0.0,) * 4,
    ) -> None:
        """Servos at tendon angles (4,), rad."""
        self.settings, self.joints = settings, joints(settings.joints)
        self.bus = EmulatedBus(
            emulator,
            settings.joints.ids,
            [
                j.servo_angle(float(angle))
                for j, angle in zip(self.joints, angles)
            ],
        )
        for joint, servo in zip(self.joints, self.bus.servos):
            for name, value in expected(settings, joint).items():
                servo.memory[name] = value
            servo.reboot()
            servo.advance(emulator.servo.boot_time, 0.0)

    def advance(
        self, dt: float, torques: Sequence[float] | Array = (0.0,) * 4
    ) -> Array:
        """Advance the servos by dt (s) and return `angles`.

        torques: (4,) N m, of the tendons on their spools.
        """
        self.bus.advance(
            dt,
            [
                joint.servo_torque(float(t))
                for joint, t in zip(self.joints, torques)
            ],
        )
        return self.angles()

    def angles(self) -> Array:
        """Tendon angles (4,), rad, exact, without the encoder's resolution."""
        return np.array(
            [
                joint.tendon_angle(servo.shaft.angle)
                for joint, servo in zip(self.joints, self.bus.servos)
            ]
        )

    def powered(self) -> tuple[str, ...]:
        """Names of the legs whose servos have torque on."""
        return tuple(
            leg
            for leg, servo in zip(LEGS, self.bus.servos)
            if servo.memory["torque_enable"]
        )

    def driven(self) -> bool:
        """Whether instructions move a servo away from where it is."""
        return any(servo.driven() for servo in self.bus.servos)

    def watchdog_left(self) -> float:
        """Time after which the first bus watchdog stops its servo, s; inf if none is armed."""
        return self.bus.watchdog_left()

    def set_fault(self, fault: Fault, on: bool) -> None:
        """Start a fault now, or end it: then hardware errors stay until the servo is rebooted."""
        self.bus.set_fault(fault, on)

    def connect(self, clock: Clock) -> Driver:
        """Driver of these servos in the same process, on a clock (s)."""
        return Driver(
            MemoryPort(self.bus, self.settings.bus.baud, clock),
            self.settings,
            clock,
        )

    def serve(self, link: Path | None) -> PseudoTerminal:
        """Pseudo-terminal of these servos; raises ConfigError if another file has its name."""
        return PseudoTerminal(self.bus, link)
