"""Emulated XL430-W250: registers, control loop, protection.

Position mode: duty = (P/128 e + I/65536 sum e - D/16 dx) / 885 with the position error e and the
change dx of the position since the last loop, in counts. PWM mode: goal_pwm / 885. The e-manual
gives no period of the control loop, so it is a setting. Present load: motor torque / stall torque,
which on the torque-speed line is duty - speed / no-load speed. The other modes and indirect
addresses are not emulated: no driver here uses them.

A hardware error sets its bit until the servo is rebooted. If the bit is set in Shutdown (63) too,
torque goes off and cannot be switched on again before a reboot (error: result fail). Profiles: the
profile velocity is followed, the profile acceleration is not modelled.

Motor, gear and temperature of an emulated servo.

The motor's speed follows its torque-speed line with time constant motor_time, as `pid` does in
`dynamics/servo.py`:

    motor_time dw/dt = w0 (v u - tau / tau_stall) - w

with the duty u and the load torque tau; w0 and tau_stall of `servo.yaml` hold at the supply
voltage V of the servos, v is 1 but while a fault gives a servo another voltage, v V. With torque
off the gear holds loads up to `friction`; the excess turns it along the same line, u = 0.
Temperature:

    C dT/dt = (V torque / tau_stall)^2 / R_el - (T - T_room) / R

with time constant R C, the motor's torque and its electric resistance R_el. `R`, `C`, `friction`
are assumed, not measured.

Control table of an emulated servo: reading and writing with its access rules and error numbers.

A write is executed completely or not at all. Error numbers (ROBOTIS e-manual, Protocol 2.0):

    4  value outside the register's range; a goal while the bus watchdog has tripped
    5  part of a register
    6  value outside a limit held by another register
    7  address undefined or not writable; EEPROM while torque is on
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import dynamixel_sdk as sdk

from slot_core.config import quantity
from slot_core.dynamixel.table import (
    BY_ADDRESS,
    COUNTS,
    LOAD_FULL,
    PWM_FULL,
    RAD_PER_COUNT,
    RAD_S_PER_UNIT,
    REGISTERS,
    TABLE,
    TABLE_END,
    VOLTAGE_UNIT,
    WATCHDOG_UNIT,
    Mode,
    Register,
)
from slot_core.faults import HardwareError


@dataclass(frozen=True)
class ShaftSettings:
    """Gear and heat; the motor itself is in `servo.yaml`."""

    friction: float = quantity(
        "load torque that the gear holds with torque off", "N m", 0.0, 10.0
    )
    resistance: float = quantity(
        "electric resistance of the motor at stall", "ohm", 0.1, 1e3
    )
    room: float = quantity("room temperature", "degC", -40.0, 60.0)
    thermal_resistance: float = quantity(
        "thermal resistance from motor to room", "K/W", 0.0, 100.0
    )
    thermal_time: float = quantity(
        "time constant of the temperature", "s", 1.0, 1e5
    )


class Motor(NamedTuple):
    """Torque-speed line at a supply voltage, and time constant of the motor."""

    voltage: float  # V
    speed: float  # rad/s, no-load speed
    stall: float  # N m, stall torque
    time: float  # s, time constant of the speed


class Shaft:
    """Output shaft: angle (rad), speed (rad/s), motor torque (N m), temperature (degC)."""

    def __init__(
        self, motor: Motor, settings: ShaftSettings, angle: float
    ) -> None:
        self.motor, self.settings = motor, settings
        self.angle, self.speed = angle, 0.0
        self.temperature = settings.room
        self.torque = 0.0

    def advance(
        self, duty: float | None, load: float, voltage: float, h: float
    ) -> None:
        """Advance by h s at a duty (None: torque off), supply voltage (V) and load torque (N m).

        A positive load lowers the angle.
        """
        supply = voltage / self.motor.voltage
        self.speed += (self._target(duty, load, supply) - self.speed) * (
            h / (self.motor.time + h)
        )
        self.angle += h * self.speed
        self._heat(duty, supply, h)

    def _target(self, duty: float | None, load: float, supply: float) -> float:
        motor = self.motor
        if duty is not None:
            return motor.speed * (supply * duty - load / motor.stall)
        excess = max(abs(load) - self.settings.friction, 0.0)
        return -motor.speed * math.copysign(excess, load) / motor.stall

    def _heat(self, duty: float | None, supply: float, h: float) -> None:
        settings, motor = self.settings, self.motor
        share = (
            0.0 if duty is None else supply * duty - self.speed / motor.speed
        )
        self.torque = share * motor.stall
        power = (motor.voltage * share) ** 2 / settings.resistance
        steady = settings.room + settings.thermal_resistance * power
        self.temperature += (steady - self.temperature) * (
            h / settings.thermal_time
        )


GOALS = ("goal_pwm", "goal_velocity", "goal_position")
TRIPPED = -1  # value of Bus Watchdog after it has tripped


class RegisterError(Exception):
    """A rejected instruction; `number`: error number of the status packet."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class Memory:
    """Registers of one servo; values by register name."""

    def __init__(self) -> None:
        self._bytes = bytearray(TABLE_END)
        self._values: dict[
            str, int
        ] = {}  # what the bytes stand for: they are read all the time
        for register in REGISTERS:
            self[register.name] = register.initial

    def __getitem__(self, name: str) -> int:
        return self._values[name]

    def __setitem__(self, name: str, value: int) -> None:
        register = TABLE[name]
        self._bytes[register.address : register.end] = register.encode(value)
        self._values[name] = int(value)

    def reset(self) -> None:
        """Set the writable registers of RAM to their initial values."""
        for register in REGISTERS:
            if register.writable and not register.eeprom:
                self[register.name] = register.initial

    def read(self, address: int, size: int) -> bytes:
        """`size` bytes from an address; raises RegisterError."""
        wanted = range(address, address + size)
        if not wanted or any(place not in BY_ADDRESS for place in wanted):
            raise RegisterError(sdk.ERRNUM_ACCESS)
        return bytes(self._bytes[address : address + size])

    def write(self, address: int, data: bytes) -> None:
        """Write bytes from an address; raises RegisterError and then changes nothing."""
        for register, value in self.checked(address, data).items():
            self[register] = value

    def checked(self, address: int, data: bytes) -> dict[str, int]:
        """Values that a write would set, by register name; raises RegisterError."""
        if not data:
            raise RegisterError(sdk.ERRNUM_DATA_LENGTH)
        end, values = address + len(data), {}
        for register in dict.fromkeys(map(BY_ADDRESS.get, range(address, end))):
            if (
                register is None
                or not register.writable
                or (register.eeprom and self["torque_enable"])
            ):
                raise RegisterError(sdk.ERRNUM_ACCESS)
            if register.address < address or register.end > end:
                raise RegisterError(sdk.ERRNUM_DATA_LENGTH)
            values[register.name] = register.decode(
                data[register.address - address : register.end - address]
            )
            self._check(register, values[register.name])
        return values

    def _check(self, register: Register, value: int) -> None:
        name = register.name
        refused = name in GOALS or (name == "bus_watchdog" and value)
        if (
            not register.low <= value <= register.high
            or (name == "operating_mode" and value not in set(Mode))
            or (refused and self["bus_watchdog"] == TRIPPED)
        ):
            raise RegisterError(sdk.ERRNUM_DATA_RANGE)
        low, high = self.limits(name)
        if not low <= value <= high:
            raise RegisterError(sdk.ERRNUM_DATA_LIMIT)

    def limits(self, name: str) -> tuple[int, int]:
        """Limits of a register held by other registers; its own range if there are none."""
        if name in ("goal_pwm", "goal_velocity"):
            limit = self[name.removeprefix("goal_") + "_limit"]
            return -limit, limit
        if name == "goal_position" and self["operating_mode"] == Mode.POSITION:
            return self["min_position_limit"], self["max_position_limit"]
        return TABLE[name].low, TABLE[name].high


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
        return sdk.ERRBIT_ALERT if self.memory["hardware_error_status"] else 0

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
            raise RegisterError(sdk.ERRNUM_RESULT_FAIL)
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
        is_away = (
            memory["goal_pwm"] != 0
            if memory["operating_mode"] == Mode.PWM
            else memory["goal_position"] != self.position()
        )
        return bool(memory["torque_enable"]) and is_away

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
        self._shut_down, self._overload_time = False, 0.0
        memory["hardware_error_status"] = memory["bus_watchdog"] = 0
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
        self._advance_profile(h)
        error = self._trajectory - self.position()
        change = self._velocity() * RAD_S_PER_UNIT * h / RAD_PER_COUNT
        integral = self._integral + memory["position_i_gain"] / 65536 * error
        p, d = memory["position_p_gain"] / 128, memory["position_d_gain"] / 16
        unlimited = (p * error + integral - d * change) / PWM_FULL
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
