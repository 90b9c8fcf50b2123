"""The simulated robot on emulated servos: the shafts of the bus wind the tendons.

In every time step the servos turn for that step against the torques of the tendons at its begin,
and the spools end the step where the shafts are. Model, lag and backlash of `servo.yaml` are not
used: the emulated servo stands in their place.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from slot_core.config import ConfigError
from slot_core.dynamics.scene import Scene
from slot_core.dynamics.servo import ServoSettings
from slot_core.dynamixel.settings import DynamixelSettings
from slot_core.dynamixel.table import PWM_FULL, RAD_PER_COUNT
from slot_core.emulator.emulated_bus import EmulatorSettings
from slot_core.faults import BUS_KINDS, Fault
from slot_core.robot import LEGS, Array, Robot
from slot_core.simulation.bus_legs import EmulatedLegs
from slot_core.simulation.plant import Plant

UNBOUNDED_RPM = 1e6  # a speed that no shaft reaches


def imposed(servo: ServoSettings, step: float) -> ServoSettings:
    """A servo that is at its command after one step (s); raises ConfigError on backlash."""
    if servo.backlash_deg:
        raise ConfigError(
            f"servo.yaml: backlash_deg = {servo.backlash_deg}: emulated servos have none"
        )
    return dataclasses.replace(servo, model="ideal", lag=step, ideal_rpm=UNBOUNDED_RPM)


def equal_law(servo: ServoSettings, settings: DynamixelSettings, period: float) -> ServoSettings:
    """The `pid` of dynamics/servo.py that does to the tendons what emulated servos do.

    The motor is that of `servo`, the gains are those of the servos' own loop (position control),
    `period` (s) is that loop's; angles, speeds and torques become the tendon's.
    """
    ratio, gains = settings.joints.servo_per_tendon, settings.gains
    duty = ratio / RAD_PER_COUNT / PWM_FULL  # of a tendon angle (rad), as registers of gain 1
    return dataclasses.replace(
        servo,
        model="pid",
        proportional=gains.p / 128 * duty,
        integral=gains.i / 65536 * duty / period,
        derivative=gains.d / 16 * duty * period,
        no_load_rpm=servo.no_load_rpm / ratio,
        stall_torque=servo.stall_torque * ratio,
    )


class BusPlant(Plant):
    """A plant whose commands come over the bus; `command` has no effect beyond its checks."""

    def __init__(
        self,
        robot: Robot,
        scene: Scene,
        servo: ServoSettings,
        rng: np.random.Generator,
        *,
        settings: DynamixelSettings,
        emulator: EmulatorSettings,
    ) -> None:
        """The servos stand where the tendons have settled, with torque off."""
        sensors = dataclasses.replace(scene.sensors, joints=False)  # the driver reads the joints
        scene = dataclasses.replace(scene, sensors=sensors)
        super().__init__(robot, scene, imposed(servo, scene.solver.step), rng)
        self.legs = EmulatedLegs(settings, emulator, self.simulator.tendon_angle)

    def powered(self) -> tuple[str, ...]:
        """The legs whose servos are under torque."""
        servos = zip(LEGS, self.legs.bus.servos)
        return tuple(leg for leg, servo in servos if servo.memory["torque_enable"])

    def _refuse(self, fault: Fault) -> None:
        if fault.kind not in BUS_KINDS:
            super()._refuse(fault)

    def _switch(self, fault: Fault, leg: str, on: bool) -> None:
        if fault.kind not in BUS_KINDS:
            super()._switch(fault, leg, on)
            return
        act = self.legs.bus.inject if on else self.legs.bus.clear
        act(dataclasses.replace(fault, leg=leg))

    def _move(self, steps: int) -> None:
        for _ in range(steps):
            self.simulator.advance(1, self._turn_shafts())

    def _turn_shafts(self) -> Array:
        """Tendon angles (4,), rad, after a step; the tendons end where the model's range does."""
        simulator = self.simulator
        angles = self.legs.advance(simulator.scene.solver.step, simulator.servo_torque)
        return np.clip(angles, 0.0, simulator.robot.tendon.angle_max)
