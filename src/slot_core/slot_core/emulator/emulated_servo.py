"""An emulated XL430-W250: its registers, its control loop, its protection.

Position mode: duty = (P/128 e + I/65536 sum e - D/16 dx) / 885 with the error e and the change dx
of position, in counts, once a loop; PWM mode: goal_pwm / 885; velocity mode: PI on the velocity.
The e-manual gives no period for the sums, so it is a setting. The present load is the motor's
torque over the stall torque, which on the torque-speed line is duty - speed / no-load speed.

A hardware error sets its bit until the servo is rebooted; with its bit in Shutdown (63) it switches
torque off, and torque stays off. Torque can then not be switched on again: result fail. Profiles:
the velocity is kept, the acceleration is not modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from slot_core.config import quantity
from slot_core.dynamixel.packet import ALERT, Error
from slot_core.dynamixel.table import (
    COUNTS,
    LOAD_FULL,
    PWM_FULL,
    RAD_PER_COUNT,
    RAD_S_PER_UNIT,
    VOLTAGE_UNIT,
    WATCHDOG_UNIT,
    HardwareError,
    Mode,
)
from slot_core.emulator.memory import TRIPPED, Memory, RegisterError
from slot_core.emulator.shaft import Motor, Shaft, ShaftSettings


@dataclass(frozen=True)
class ServoModel:
    """What `config/emulator.yaml` holds on the servo."""

    shaft: ShaftSettings
    firmware: int = quantity("firmware version", "", 1, 255)
    loop_period: float = quantity("of the control loop", "s", 1e-4, 0.01)
    voltage: float = quantity("of the supply", "V", 0.0, 20.0)
    overload_share: float = quantity("load that is too much", "of stall", 0.0, 1.0)
    overload_time: float = quantity("how long that load is borne", "s", 0.0, 100.0)
    boot_time: float = quantity("silence after a reboot", "s", 0.0, 10.0)


class EmulatedServo:
    """One servo. Its time passes in `advance` alone."""

    def __init__(self, identity: int, model: ServoModel, motor: Motor, angle: float) -> None:
        self.model = model
        self.memory = Memory()
        self.memory["id"] = identity
        self.memory["firmware_version"] = model.firmware
        self.shaft = Shaft(motor, model.shaft, angle)
        self.voltage, self.forced_temperature = model.voltage, math.nan
        self.registered: tuple[int, bytes] | None = None
        self.time = self.heard = 0.0  # s; of the last instruction on the bus
        self._booting = 0.0
        self._shut = False
        self._integral = self._overloaded = self._left = 0.0
        self._trajectory = angle / RAD_PER_COUNT
        self._turns = 0
        self.clear_turns()
        self._restart()

    @property
    def awake(self) -> bool:
        """Whether it listens; not while it boots."""
        return self._booting <= 0.0

    @property
    def error(self) -> int:
        """Error byte of its status packets without an error number."""
        return ALERT if self.memory["hardware_error_status"] else 0

    def position(self) -> int:
        """Present position in counts, as the register has it."""
        counts = math.floor(self.shaft.angle / RAD_PER_COUNT) - COUNTS * self._turns
        reverse = -1 if self.memory["drive_mode"] & 1 else 1
        return reverse * counts + self.memory["homing_offset"]

    def read(self, address: int, size: int) -> bytes:
        """Bytes of the table; raises RegisterError."""
        self._refresh()
        return self.memory.read(address, size)

    def write(self, address: int, data: bytes) -> None:
        """Write to the table, with all that follows from it; raises RegisterError."""
        values = self.memory.checked(address, data)
        if values.get("torque_enable") and self._shut:
            raise RegisterError(Error.RESULT_FAIL)
        was_on, old_mode = self.memory["torque_enable"], self.memory["operating_mode"]
        self.memory.write(address, data)
        if "torque_enable" in values and not was_on:
            self._trajectory, self._integral = float(self.position()), 0.0
        if values.get("operating_mode", old_mode) != old_mode:
            self._change_mode()

    def reboot(self) -> None:
        """Start anew: RAM as at first, torque off, silence for a while."""
        self.memory.reset(eeprom=False)
        self._restart()
        self._booting = self.model.boot_time

    def factory_reset(self, keep: tuple[str, ...]) -> None:
        """EEPROM as delivered, but for `keep`; then reboot."""
        self.memory.reset(eeprom=True, keep=keep)
        self.reboot()

    def revive(self, image: bytes) -> None:
        """Back to an earlier content of the memory, awake, nothing registered."""
        self.memory.load(image)
        self._booting, self._shut, self.registered = 0.0, False, None

    def clear_turns(self) -> None:
        """Count the position within one turn again."""
        self._turns = math.floor(self.shaft.angle / math.tau)

    def trip(self, error: HardwareError) -> None:
        """A hardware error; switches torque off if Shutdown says so."""
        self.memory["hardware_error_status"] = self.memory["hardware_error_status"] | error
        if self.memory["shutdown"] & error:
            self._shut = True
            self.memory["torque_enable"] = 0

    def stop_by_watchdog(self) -> None:
        """The bus watchdog trips: the servo stops, and takes no goals until it is cleared."""
        memory = self.memory
        memory["bus_watchdog"] = TRIPPED
        memory["profile_velocity"] = memory["profile_acceleration"] = 0
        memory["goal_velocity"] = 0
        if memory["operating_mode"] == Mode.PWM:
            memory["goal_pwm"] = 0
        memory["goal_position"] = self.position()
        self._trajectory, self._integral = float(self.position()), 0.0

    def advance(self, dt: float, load: float) -> None:
        """Let dt s pass under a load torque (N m) that pulls the angle down."""
        self.time += dt
        self._booting = max(self._booting - dt, 0.0)
        self._watch()
        self._left += dt
        while self._left >= self.model.loop_period - 1e-9:
            self._left -= self.model.loop_period
            self._loop(load, self.model.loop_period)
        self._protect(dt)

    def _restart(self) -> None:
        memory = self.memory
        self._shut, self._overloaded, self.registered = False, 0.0, None
        memory["hardware_error_status"] = memory["registered_instruction"] = 0
        memory["bus_watchdog"] = 0
        memory["goal_pwm"] = memory["pwm_limit"]
        memory["goal_position"] = self.position()
        self._trajectory, self._integral = float(self.position()), 0.0

    def _change_mode(self) -> None:
        memory = self.memory
        memory["goal_pwm"] = memory["pwm_limit"]
        memory["profile_velocity"] = memory["profile_acceleration"] = 0
        for name in ("position_p_gain", "position_i_gain", "position_d_gain"):
            memory.restore(name)
        memory["goal_position"] = self.position()

    def _watch(self) -> None:
        code = self.memory["bus_watchdog"]
        if code <= 0 or not self.memory["torque_enable"]:
            return
        if self.time - self.heard > code * WATCHDOG_UNIT:
            self.stop_by_watchdog()

    def _loop(self, load: float, h: float) -> None:
        duty = self._duty(h) if self.memory["torque_enable"] else None
        self.memory["present_pwm"] = round((duty or 0.0) * PWM_FULL)
        reverse = -1.0 if self.memory["drive_mode"] & 1 else 1.0
        outward = None if duty is None else reverse * duty
        self.shaft.advance(outward, load, self.voltage, h)

    def _duty(self, h: float) -> float:
        memory, mode = self.memory, self.memory["operating_mode"]
        if mode == Mode.PWM:
            return memory["goal_pwm"] / PWM_FULL
        limit = min(abs(memory["goal_pwm"]), memory["pwm_limit"]) / PWM_FULL
        if mode == Mode.VELOCITY:
            error = memory["goal_velocity"] - self._velocity()
            gains = (memory["velocity_p_gain"] / 128, memory["velocity_i_gain"] / 65536, 0.0)
        else:
            self._follow(h)
            error = self._trajectory - self.position()
            gains = (
                memory["position_p_gain"] / 128,
                memory["position_i_gain"] / 65536,
                memory["position_d_gain"] / 16,
            )
        return self._pid(error, gains, limit, h)

    def _pid(self, error: float, gains: tuple[float, ...], limit: float, h: float) -> float:
        change = self._velocity() * RAD_S_PER_UNIT * h / RAD_PER_COUNT
        grown = self._integral + gains[1] * error
        wanted = (gains[0] * error + grown - gains[2] * change) / PWM_FULL
        duty = min(max(wanted, -limit), limit)
        if (wanted - duty) * error <= 0.0:
            self._integral = grown
        return duty

    def _follow(self, h: float) -> None:
        """The trajectory of a profile with its velocity alone."""
        goal = self.memory["goal_position"]
        reach = self.memory["profile_velocity"] * RAD_S_PER_UNIT * h / RAD_PER_COUNT
        step = goal - self._trajectory
        self._trajectory += step if reach == 0.0 else min(max(step, -reach), reach)

    def _velocity(self) -> float:
        reverse = -1.0 if self.memory["drive_mode"] & 1 else 1.0
        return reverse * self.shaft.speed / RAD_S_PER_UNIT

    def _protect(self, dt: float) -> None:
        memory, shaft = self.memory, self.shaft
        load = abs(shaft.torque) / shaft.motor.stall
        self._overloaded = self._overloaded + dt if load > self.model.overload_share else 0.0
        if self._overloaded > self.model.overload_time:
            self.trip(HardwareError.OVERLOAD)
        if self.temperature() > memory["temperature_limit"]:
            self.trip(HardwareError.OVERHEATING)
        volts = self.voltage / VOLTAGE_UNIT
        if not memory["min_voltage_limit"] <= volts <= memory["max_voltage_limit"]:
            self.trip(HardwareError.INPUT_VOLTAGE)

    def moving(self) -> bool:
        """Whether it turns faster than its threshold."""
        return abs(self._velocity()) > self.memory["moving_threshold"]

    def temperature(self) -> float:
        """Temperature that the servo sees, degC."""
        forced = self.forced_temperature
        return self.shaft.temperature if math.isnan(forced) else forced

    def _refresh(self) -> None:
        """Bring the registers of measurements up to date."""
        memory, load = self.memory, self.shaft.torque / self.shaft.motor.stall
        reverse = -1 if memory["drive_mode"] & 1 else 1
        memory["realtime_tick"] = math.floor(self.time * 1e3) % 32768
        memory["present_position"] = self.position()
        memory["present_velocity"] = round(self._velocity())
        memory["present_load"] = reverse * round(min(max(load, -1.0), 1.0) * LOAD_FULL)
        memory["moving"] = int(self.moving())
        memory["position_trajectory"] = round(self._trajectory)
        memory["present_input_voltage"] = round(self.voltage / VOLTAGE_UNIT)
        memory["present_temperature"] = round(min(max(self.temperature(), 0.0), 255.0))
