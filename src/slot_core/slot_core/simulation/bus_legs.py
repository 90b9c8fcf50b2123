"""Emulated servos that wind the tendons of a simulated robot, in angles of the tendons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from slot_core.dynamixel.checks import expected
from slot_core.dynamixel.joints import joints
from slot_core.dynamixel.settings import DynamixelSettings
from slot_core.emulator.emulated_bus import EmulatedBus, EmulatorSettings
from slot_core.robot import Array


class EmulatedLegs:
    """Bus of emulated servos with the registers of `settings`, at given tendon angles (rad)."""

    def __init__(
        self,
        settings: DynamixelSettings,
        emulator: EmulatorSettings,
        angles: Sequence[float] | Array = (0.0,) * 4,
    ) -> None:
        self.joints = joints(settings.joints)
        shaft_angles = [j.servo_angle(float(angle)) for j, angle in zip(self.joints, angles)]
        self.bus = EmulatedBus(emulator, settings.joints.ids, shaft_angles)
        for joint, servo in zip(self.joints, self.bus.servos):
            for name, value in expected(settings, joint).items():
                servo.memory[name] = value
            servo.reboot()
            servo.advance(emulator.servo.boot_time, 0.0)

    def advance(self, dt: float, torques: Sequence[float] | Array = (0.0,) * 4) -> Array:
        """Advance the servos by dt (s) and return `angles`.

        torques: (4,) N m, of the tendons on their spools.
        """
        loads = [joint.servo_torque(float(t)) for joint, t in zip(self.joints, torques)]
        self.bus.advance(dt, loads)
        return self.angles()

    def angles(self) -> Array:
        """Tendon angles (4,), rad, exact, without the encoder's resolution."""
        return np.array(
            [
                joint.tendon_angle(servo.shaft.angle)
                for joint, servo in zip(self.joints, self.bus.servos)
            ]
        )
