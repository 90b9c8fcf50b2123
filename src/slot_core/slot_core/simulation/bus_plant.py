"""The simulated robot on emulated servos, whose shafts wind the tendons.

In every time step the servos advance by that step, loaded by the tendon torques at its start; the
spools end the step at the angles of the shafts. The emulated servo replaces model, lag and backlash
of `servo.yaml`; its supply voltage is that of the scene.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from slot_core.clock import SECOND
from slot_core.config import ConfigError
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamixel.settings import DynamixelSettings
from slot_core.emulator.emulated_bus import EmulatorSettings
from slot_core.faults import BUS_KINDS, Fault
from slot_core.robot import LEGS, Array, RobotParameters
from slot_core.simulation.bus_legs import EmulatedLegs
from slot_core.simulation.plant import Plant

UNBOUNDED_RPM = 1e6  # above the speed of any shaft


def immediate_servo(servo: ServoSettings, step: float) -> ServoSettings:
    """Ideal servo that reaches its command within one step (s); raises ConfigError on backlash."""
    if servo.backlash_deg:
        raise ConfigError(
            f"servo.yaml: backlash_deg = {servo.backlash_deg}: emulated servos have none"
        )
    return dataclasses.replace(servo, model="ideal", lag=step, ideal_rpm=UNBOUNDED_RPM)


class BusPlant(Plant):
    """Simulated robot whose servos take their commands from the bus; `command` only checks."""

    def __init__(
        self,
        robot: RobotParameters,
        scene: Scene,
        servo: ServoSettings,
        rng: np.random.Generator,
        *,
        settings: DynamixelSettings,
        emulator: EmulatorSettings,
    ) -> None:
        """Start with the servos at the settled tendon angles, torque off."""
        sensors = dataclasses.replace(scene.sensors, joints=False)  # the driver reads the joints
        scene = dataclasses.replace(scene, sensors=sensors)
        super().__init__(robot, scene, immediate_servo(servo, scene.solver.step), rng)
        supplied = dataclasses.replace(emulator.servo, voltage=scene.supply_voltage)
        emulator = dataclasses.replace(emulator, servo=supplied)
        self.legs = EmulatedLegs(settings, emulator, self.simulator.tendon_angle)

    def powered(self) -> tuple[str, ...]:
        """Names of the legs whose servos have torque on."""
        servos = zip(LEGS, self.legs.bus.servos)
        return tuple(leg for leg, servo in servos if servo.memory["torque_enable"])

    def watchdog_due(self) -> int | None:
        """Time (ns) up to which no bus watchdog stops a servo; None if none is armed."""
        left = self.legs.bus.watchdog_left()
        if math.isinf(left):
            return None
        return self.now + (math.floor(left * SECOND) // self._step - 1) * self._step

    def _require_supported(self, fault: Fault) -> None:
        if fault.kind not in BUS_KINDS:
            super()._require_supported(fault)

    def _set_fault(self, fault: Fault, leg: str, on: bool) -> None:
        if fault.kind not in BUS_KINDS:
            super()._set_fault(fault, leg, on)
            return
        act = self.legs.bus.inject if on else self.legs.bus.clear
        act(dataclasses.replace(fault, leg=leg))

    def _advance_robot(self, steps: int) -> None:
        for _ in range(steps):
            self.simulator.advance(1, self._advance_shafts())

    def _advance_shafts(self) -> Array:
        """Advance the servos by a step; tendon angles (4,), rad, clipped to [0, angle_max]."""
        simulator = self.simulator
        angles = self.legs.advance(simulator.scene.solver.step, simulator.servo_torque)
        return np.clip(angles, 0.0, simulator.robot.tendon.angle_max)
