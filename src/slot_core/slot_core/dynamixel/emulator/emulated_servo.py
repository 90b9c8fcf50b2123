"""Emulated XL430-W250: registers, control loop, protection.

Position mode: duty = (P/128 e + I/65536 sum e - D/16 dx) / 885 with the position error e and the
change dx of the position since the last loop, in counts. PWM mode: goal_pwm / 885. Velocity mode:
PI on the velocity. The e-manual gives no period of the control loop, so it is a setting. Present
load: motor torque / stall torque, which on the torque-speed line is duty - speed / no-load speed.

A hardware error sets its bit until the servo is rebooted. If the bit is set in Shutdown (63) too,
torque goes off and cannot be switched on again before a reboot (error: result fail). Profiles: the
profile velocity is followed, the profile acceleration is not modelled.
"""

import math
from dataclasses import dataclass

from slot_core.config import quantity
from slot_core.dynamixel.emulator.memory import TRIPPED, Memory, RegisterError
from slot_core.dynamixel.emulator.shaft import Motor, Shaft, ShaftSettings
from slot_core.dynamixel.packet import ALERT, Error
from slot_core.dynamixel.table import (
    COUNTS,
    LOAD_FULL,
    PWM_FULL,
    RAD_PER_COUNT,
    RAD_S_PER_UNIT,
    TABLE,
    VOLTAGE_UNIT,
    WATCHDOG_UNIT,
    Mode,
)
from slot_core.faults import HardwareError


@dataclass(frozen=True)
class ServoModel:
    """Settings of the emulated servos."""

    shaft: ShaftSettings
    firmware: int = quantity("firmware version", "", 1, 255)
    loop_period: float = quantity("period of the control loop", "s", 1e-4, 0.01)
    voltage: float = quantity(
        "supply voltage; with a robot that of its scene", "V", 1.0, 20.0
    )
    overload_share: float = quantity(
        "load that counts as overload", "of stall", 0.0, 1.0
    )
    overload_time: float = quantity(
        "overload until the hardware error", "s", 0.0, 100.0
    )
    boot_time: float = quantity(
        "time without answers after a reboot", "s", 0.0, 10.0
    )


class EmulatedServo:
    """One emulated servo; its time passes only in `advance`."""

    def __init__(
        self, identity: int, model: ServoModel, motor: Motor, angle: float
    ) -> None:
        self.model = model
        self.memory = Memory()
        self.memory["id"] = identity
        self.memory["firmware_version"] = model.firmware
        self.shaft = Shaft(motor, model.shaft, angle)
        self.voltage, self.forced_temperature = model.voltage, math.nan
        # address and data of a Reg Write
        self.registered: tuple[int, bytes] | None = None
        self.time = 0.0  # s
        # s, time of the last instruction on the bus
        self.last_instruction = 0.0
        self._boot_left = 0.0  # s
        self._shut_down = False
        self._integral = 0.0
        self._overload_time = 0.0  # s for which the load has been too high
        self._unsimulated = 0.0  # s, shorter than a loop period
        self._trajectory = angle / RAD_PER_COUNT  # counts
        self._turns = math.floor(angle / math.tau)
        self._restart()

    @property
    def awake(self) -> bool:
        """Whether it receives instructions: not while it boots."""
        return self._boot_left <= 0.0

    @property
    def error(self) -> int:
        """Error byte of its status packets, without an error number."""
        return ALERT if self.memory["hardware_error_status"] else 0

    @property
    def _sign(self) -> int:
        return -1 if self.memory["drive_mode"] & 1 else 1  # Reverse Mode

    def position(self) -> int:
        """Value of Present Position, counts."""
        counts = (
            math.floor(self.shaft.angle / RAD_PER_COUNT) - COUNTS * self._turns
        )
        return self._sign * counts + self.memory["homing_offset"]

    def read(self, address: int, size: int) -> bytes:
        """Bytes of the control table; raises RegisterError."""
        self._refresh()
        return self.memory.read(address, size)

    def write(self, address: int, data: bytes) -> None:
        """Write to the control table and apply the side effects; raises RegisterError."""
        values = self.memory.checked(address, data)
        if values.get("torque_enable") and self._shut_down:
            raise RegisterError(Error.RESULT_FAIL)
        was_on, old_mode = (
            self.memory["torque_enable"],
            self.memory["operating_mode"],
        )
        self.memory.write(address, data)
        if "torque_enable" in values and not was_on:
            self._trajectory, self._integral = float(self.position()), 0.0
        if values.get("operating_mode", old_mode) != old_mode:
            self._change_mode()

    def reboot(self) -> None:
        """Reboot: RAM at its initial values, torque off, no answers for `boot_time`."""
        self.memory.reset()
        self._restart()
        self._boot_left = self.model.boot_time

    def driven(self) -> bool:
        """Whether instructions move it: torque, and a duty, a speed or a goal away from it."""
        memory = self.memory
        goal, rest = {
            Mode.PWM: ("goal_pwm", 0),
            Mode.VELOCITY: ("goal_velocity", 0),
        }.get(
            Mode(memory["operating_mode"]), ("goal_position", self.position())
        )
        return bool(memory["torque_enable"]) and memory[goal] != rest

    def watchdog_left(self) -> float:
        """Time after which the bus watchdog stops the servo, s; inf if it is not armed."""
        code = self.memory["bus_watchdog"]
        if code <= 0 or not self.memory["torque_enable"]:
            return math.inf
        return code * WATCHDOG_UNIT - (self.time - self.last_instruction)

    def trip(self, error: HardwareError) -> None:
        """Set a hardware error; switch torque off if its bit is set in Shutdown."""
        self.memory["hardware_error_status"] = (
            self.memory["hardware_error_status"] | error
        )
        if self.memory["shutdown"] & error:
            self._shut_down = True
            self.memory["torque_enable"] = 0

    def stop_by_watchdog(self) -> None:
        """Trip the bus watchdog: the servo stops and rejects goals until it is cleared."""
        memory = self.memory
        memory["bus_watchdog"] = TRIPPED
        memory["profile_velocity"] = memory["profile_acceleration"] = 0
        memory["goal_velocity"] = 0
        if memory["operating_mode"] == Mode.PWM:
            memory["goal_pwm"] = 0
        memory["goal_position"] = self.position()
        self._trajectory, self._integral = float(self.position()), 0.0

    def advance(self, dt: float, load: float) -> None:
        """Advance by dt s under a load torque (N m); a positive one lowers the angle."""
        self.time += dt
        self._boot_left = max(self._boot_left - dt, 0.0)
        if self.watchdog_left() < 0.0:
            self.stop_by_watchdog()
        self._unsimulated += dt
        h = self.model.loop_period
        while self._unsimulated >= h - 1e-9:
            self._unsimulated -= h
            duty = self._duty(h) if self.memory["torque_enable"] else None
            self.memory["present_pwm"] = round((duty or 0.0) * PWM_FULL)
            shaft_duty = None if duty is None else self._sign * duty
            self.shaft.advance(shaft_duty, load, self.voltage, h)
        self._protect(dt)

    def _restart(self) -> None:
        memory = self.memory
        self._shut_down, self._overload_time, self.registered = False, 0.0, None
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
            memory[name] = TABLE[name].initial
        memory["goal_position"] = self.position()

    def _duty(self, h: float) -> float:
        memory, mode = self.memory, self.memory["operating_mode"]
        if mode == Mode.PWM:
            return memory["goal_pwm"] / PWM_FULL
        limit = min(abs(memory["goal_pwm"]), memory["pwm_limit"]) / PWM_FULL
        if mode == Mode.VELOCITY:
            error = memory["goal_velocity"] - self._velocity()
            gains = (
                memory["velocity_p_gain"] / 128,
                memory["velocity_i_gain"] / 65536,
                0.0,
            )
        else:
            self._advance_profile(h)
            error = self._trajectory - self.position()
            gains = (
                memory["position_p_gain"] / 128,
                memory["position_i_gain"] / 65536,
                memory["position_d_gain"] / 16,
            )
        return self._pid(error, gains, limit, h)

    def _pid(
        self, error: float, gains: tuple[float, ...], limit: float, h: float
    ) -> float:
        change = self._velocity() * RAD_S_PER_UNIT * h / RAD_PER_COUNT
        integral = self._integral + gains[1] * error
        unlimited = (gains[0] * error + integral - gains[2] * change) / PWM_FULL
        duty = min(max(unlimited, -limit), limit)
        if (unlimited - duty) * error <= 0.0:
            self._integral = integral
        return duty

    def _advance_profile(self, h: float) -> None:
        """Move the position trajectory to the goal at no more than the profile velocity."""
        goal = self.memory["goal_position"]
        reach = (
            self.memory["profile_velocity"] * RAD_S_PER_UNIT * h / RAD_PER_COUNT
        )
        step = goal - self._trajectory
        self._trajectory += (
            step if reach == 0.0 else min(max(step, -reach), reach)
        )

    def _velocity(self) -> float:
        return self._sign * self.shaft.speed / RAD_S_PER_UNIT

    def _protect(self, dt: float) -> None:
        memory, shaft = self.memory, self.shaft
        load = abs(shaft.torque) / shaft.motor.stall
        self._overload_time = (
            self._overload_time + dt
            if load > self.model.overload_share
            else 0.0
        )
        if self._overload_time > self.model.overload_time:
            self.trip(HardwareError.OVERLOAD)
        if self.temperature() > memory["temperature_limit"]:
            self.trip(HardwareError.OVERHEATING)
        volts = self.voltage / VOLTAGE_UNIT
        if (
            not memory["min_voltage_limit"]
            <= volts
            <= memory["max_voltage_limit"]
        ):
            self.trip(HardwareError.INPUT_VOLTAGE)

    def temperature(self) -> float:
        """Measured temperature, degC."""
        forced = self.forced_temperature
        return self.shaft.temperature if math.isnan(forced) else forced

    def _refresh(self) -> None:
        """Update the registers of measurements."""
        memory, load = self.memory, self.shaft.torque / self.shaft.motor.stall
        memory["realtime_tick"] = math.floor(self.time * 1e3) % 32768
        memory["present_position"] = self.position()
        memory["present_velocity"] = round(self._velocity())
        memory["present_load"] = self._sign * round(
            min(max(load, -1.0), 1.0) * LOAD_FULL
        )
        memory["moving"] = int(
            abs(self._velocity()) > memory["moving_threshold"]
        )
        memory["position_trajectory"] = round(self._trajectory)
        memory["present_input_voltage"] = round(self.voltage / VOLTAGE_UNIT)
        memory["present_temperature"] = round(
            min(max(self.temperature(), 0.0), 255.0)
        )
