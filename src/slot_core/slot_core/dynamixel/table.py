"""The control table of the XL430-W250 as data.

Source: ROBOTIS e-manual, XL430-W250, "Control Table" (addresses, sizes, initial values, ranges and
units), of firmware 45. Values on the bus are little-endian; signed ones are two's complement.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Iterator
from dataclasses import dataclass

from slot_core.faults import HARDWARE_ERROR_BITS

MODEL_NUMBER = 1060
COUNTS = 4096  # of the position encoder, per turn
TABLE_END = 662  # first address after the table
RAM_START = 64  # first address of the RAM area; below it: EEPROM
NO_SECONDARY_ID = 255  # value of Secondary ID (12) that disables it

RAD_PER_COUNT = math.tau / COUNTS
RPM_UNIT = 0.229  # rev/min
RAD_S_PER_UNIT = RPM_UNIT * math.tau / 60.0
PWM_FULL = 885  # 100 % duty
LOAD_FULL = 1000  # 100 % load
WATCHDOG_UNIT = 0.020  # s
RETURN_DELAY_UNIT = 2e-6  # s
VOLTAGE_UNIT = 0.1  # V

BAUD_RATES = (
    9600,
    57600,
    115200,
    1000000,
    2000000,
    3000000,
    4000000,
    4500000,
)  # baud, by the value of Baud Rate (8)


class Mode(enum.IntEnum):
    """Operating Mode (11)."""

    VELOCITY = 1
    POSITION = 3
    EXTENDED_POSITION = 4
    PWM = 16


@dataclass(frozen=True)
class Register:
    """One item of the control table; `low`, `high`: its range, both included, in its unit."""

    name: str
    address: int
    size: int
    unit: str
    writable: bool
    initial: int
    low: int
    high: int
    signed: bool = False

    @property
    def eeprom(self) -> bool:
        """Whether it is in EEPROM: kept without power, write-protected while torque is on."""
        return self.address < RAM_START

    @property
    def end(self) -> int:
        """First address after it."""
        return self.address + self.size

    def encode(self, value: int) -> bytes:
        """Bytes on the bus; raises OverflowError for a value that `size` bytes cannot hold."""
        return int(value).to_bytes(self.size, "little", signed=self.signed)

    def decode(self, data: bytes) -> int:
        """Value of `size` bytes from the bus; raises ValueError for another number of bytes."""
        if len(data) != self.size:
            raise ValueError(f"{self.name}: {len(data)} bytes, expected {self.size}")
        return int.from_bytes(data, "little", signed=self.signed)


_GAIN = (0, 16383)
_FULL = {1: (0, 255), 2: (0, 65535), 4: (0, 2**32 - 1)}

# name, address, size, unit, access, initial value, (low, high), signed if "s"
_ROWS: tuple[tuple[str, int, int, str, str, int, tuple[int, int], str], ...] = (
    ("model_number", 0, 2, "", "r", MODEL_NUMBER, _FULL[2], ""),
    ("model_information", 2, 4, "", "r", 0, _FULL[4], ""),
    ("firmware_version", 6, 1, "", "r", 45, _FULL[1], ""),
    ("id", 7, 1, "", "rw", 1, (0, 252), ""),
    ("baud_rate", 8, 1, "code", "rw", 1, (0, 7), ""),
    ("return_delay_time", 9, 1, "2 us", "rw", 250, (0, 254), ""),
    ("drive_mode", 10, 1, "bits", "rw", 0, (0, 13), ""),
    ("operating_mode", 11, 1, "", "rw", Mode.POSITION, (0, 16), ""),
    ("secondary_id", 12, 1, "", "rw", NO_SECONDARY_ID, (0, 255), ""),
    ("protocol_type", 13, 1, "", "rw", 2, (1, 2), ""),
    ("homing_offset", 20, 4, "count", "rw", 0, (-1044479, 1044479), "s"),
    ("moving_threshold", 24, 4, "0.229 rpm", "rw", 10, (0, 1023), ""),
    ("temperature_limit", 31, 1, "degC", "rw", 72, (0, 100), ""),
    ("max_voltage_limit", 32, 2, "0.1 V", "rw", 140, (60, 140), ""),
    ("min_voltage_limit", 34, 2, "0.1 V", "rw", 60, (60, 140), ""),
    ("pwm_limit", 36, 2, "1/885", "rw", PWM_FULL, (0, PWM_FULL), ""),
    ("velocity_limit", 44, 4, "0.229 rpm", "rw", 265, (0, 1023), ""),
    ("max_position_limit", 48, 4, "count", "rw", COUNTS - 1, (0, COUNTS - 1), ""),
    ("min_position_limit", 52, 4, "count", "rw", 0, (0, COUNTS - 1), ""),
    ("startup_configuration", 60, 1, "bits", "rw", 0, (0, 3), ""),
    ("shutdown", 63, 1, "bits", "rw", 52, (0, HARDWARE_ERROR_BITS), ""),
    ("torque_enable", 64, 1, "", "rw", 0, (0, 1), ""),
    ("led", 65, 1, "", "rw", 0, (0, 1), ""),
    ("status_return_level", 68, 1, "", "rw", 2, (0, 2), ""),
    ("registered_instruction", 69, 1, "", "r", 0, (0, 1), ""),
    ("hardware_error_status", 70, 1, "bits", "r", 0, _FULL[1], ""),
    ("velocity_i_gain", 76, 2, "1/65536", "rw", 1000, _GAIN, ""),
    ("velocity_p_gain", 78, 2, "1/128", "rw", 100, _GAIN, ""),
    ("position_d_gain", 80, 2, "1/16", "rw", 4000, _GAIN, ""),
    ("position_i_gain", 82, 2, "1/65536", "rw", 0, _GAIN, ""),
    ("position_p_gain", 84, 2, "1/128", "rw", 640, _GAIN, ""),
    ("feedforward_2nd_gain", 88, 2, "1/4", "rw", 0, _GAIN, ""),
    ("feedforward_1st_gain", 90, 2, "1/4", "rw", 0, _GAIN, ""),
    (
        "bus_watchdog",
        98,
        1,
        "20 ms",
        "rw",
        0,
        (0, 127),
        "s",
    ),  # reads -1 after it has tripped
    ("goal_pwm", 100, 2, "1/885", "rw", PWM_FULL, (-PWM_FULL, PWM_FULL), "s"),
    ("goal_velocity", 104, 4, "0.229 rpm", "rw", 0, (-1023, 1023), "s"),
    ("profile_acceleration", 108, 4, "214.577 rev/min^2", "rw", 0, (0, 32767), ""),
    ("profile_velocity", 112, 4, "0.229 rpm", "rw", 0, (0, 32767), ""),
    ("goal_position", 116, 4, "count", "rw", 0, (-1048575, 1048575), "s"),
    ("realtime_tick", 120, 2, "ms", "r", 0, (0, 32767), ""),
    ("moving", 122, 1, "", "r", 0, (0, 1), ""),
    ("moving_status", 123, 1, "bits", "r", 0, _FULL[1], ""),
    ("present_pwm", 124, 2, "1/885", "r", 0, (-PWM_FULL, PWM_FULL), "s"),
    ("present_load", 126, 2, "0.1 %", "r", 0, (-LOAD_FULL, LOAD_FULL), "s"),
    ("present_velocity", 128, 4, "0.229 rpm", "r", 0, (-(2**31), 2**31 - 1), "s"),
    ("present_position", 132, 4, "count", "r", 0, (-(2**31), 2**31 - 1), "s"),
    ("velocity_trajectory", 136, 4, "0.229 rpm", "r", 0, (-(2**31), 2**31 - 1), "s"),
    ("position_trajectory", 140, 4, "count", "r", 0, (-(2**31), 2**31 - 1), "s"),
    ("present_input_voltage", 144, 2, "0.1 V", "r", 0, _FULL[2], ""),
    ("present_temperature", 146, 1, "degC", "r", 0, _FULL[1], ""),
    ("backup_ready", 147, 1, "", "r", 0, (0, 1), ""),
)

# Two banks of 28: indirect data k is an alias of the byte whose address is in indirect address k.
INDIRECT_BANKS = ((168, 224), (578, 634))  # first address register, first data byte
INDIRECT_COUNT = 28


def _indirect() -> Iterator[Register]:
    for bank, (address, data) in enumerate(INDIRECT_BANKS):
        for i in range(INDIRECT_COUNT):
            number = bank * INDIRECT_COUNT + i + 1
            where, limits = address + 2 * i, (RAM_START, TABLE_END - 1)
            yield Register(
                f"indirect_address_{number}", where, 2, "", True, data + i, *limits
            )
            yield Register(f"indirect_data_{number}", data + i, 1, "", True, 0, 0, 255)


REGISTERS: tuple[Register, ...] = tuple(
    Register(
        name, address, size, unit, access == "rw", int(initial), *limits, sign == "s"
    )
    for name, address, size, unit, access, initial, limits, sign in _ROWS
) + tuple(_indirect())

TABLE: dict[str, Register] = {register.name: register for register in REGISTERS}

BY_ADDRESS: dict[int, Register] = {
    address: register
    for register in REGISTERS
    for address in range(register.address, register.end)
}  # register of every defined byte


def span(first: str, last: str) -> tuple[int, int]:
    """Start address and number of bytes from register `first` to `last`, both included."""
    return TABLE[first].address, TABLE[last].end - TABLE[first].address


def decode_span(address: int, data: bytes) -> dict[str, int]:
    """Values of the registers that lie wholly within `data` read from `address`, by name."""
    end = address + len(data)
    return {
        register.name: register.decode(
            data[register.address - address : register.end - address]
        )
        for register in map(BY_ADDRESS.get, range(address, end))
        if register is not None and address <= register.address and register.end <= end
    }
