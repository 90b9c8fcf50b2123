"""The control table of the XL430-W250 as data.

Source: ROBOTIS e-manual, XL430-W250, "Control Table" (addresses, sizes, initial values, ranges and
units), of firmware 45. Values on the bus are little-endian; signed ones are two's complement.
"""

import enum
import math
from collections.abc import Iterator
from dataclasses import dataclass

MODEL_NUMBER = 1060
COUNTS = 4096  # of the position encoder, per turn
TABLE_END = (
    148  # first address after the table, without indirect addresses and data
)
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

# values of Status Return Level (68); 0: ping only
ANSWER_READS, ANSWER_ALL = 1, 2

# baud, by the value of Baud Rate (8)
BAUD_RATES = (9600, 57600, 115200, 1000000, 2000000, 3000000, 4000000, 4500000)


class Mode(enum.IntEnum):
    """Operating Mode (11): those that the driver uses."""

    POSITION = 3
    PWM = 16


@dataclass(frozen=True)
class Register:
    """One item of the control table; `low`, `high`: its range, both included."""

    name: str
    address: int
    size: int  # bytes
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
            raise ValueError(
                f"{self.name}: {len(data)} bytes, expected {self.size}"
            )
        return int.from_bytes(data, "little", signed=self.signed)


# Bus Watchdog reads -1 after it has tripped. A unit of 1: a number without unit.
_ROWS = """
name                    address  bytes  access  sign  initial       lowest     highest  unit
model_number                  0      2  r       +        1060            0       65535  1
model_information             2      4  r       +           0            0  4294967295  1
firmware_version              6      1  r       +          45            0         255  1
id                            7      1  rw      +           1            0         252  1
baud_rate                     8      1  rw      +           1            0           7  code
return_delay_time             9      1  rw      +         250            0         254  2 us
drive_mode                   10      1  rw      +           0            0          13  bits
operating_mode               11      1  rw      +           3            0          16  1
secondary_id                 12      1  rw      +         255            0         255  1
protocol_type                13      1  rw      +           2            1           2  1
homing_offset                20      4  rw      +-          0     -1044479     1044479  count
moving_threshold             24      4  rw      +          10            0        1023  0.229 rpm
temperature_limit            31      1  rw      +          72            0         100  degC
max_voltage_limit            32      2  rw      +         140           60         140  0.1 V
min_voltage_limit            34      2  rw      +          60           60         140  0.1 V
pwm_limit                    36      2  rw      +         885            0         885  1/885
velocity_limit               44      4  rw      +         265            0        1023  0.229 rpm
max_position_limit           48      4  rw      +        4095            0        4095  count
min_position_limit           52      4  rw      +           0            0        4095  count
startup_configuration        60      1  rw      +           0            0           3  bits
shutdown                     63      1  rw      +          52            0          61  bits
torque_enable                64      1  rw      +           0            0           1  1
led                          65      1  rw      +           0            0           1  1
status_return_level          68      1  rw      +           2            0           2  1
registered_instruction       69      1  r       +           0            0           1  1
hardware_error_status        70      1  r       +           0            0         255  bits
velocity_i_gain              76      2  rw      +        1000            0       16383  1/65536
velocity_p_gain              78      2  rw      +         100            0       16383  1/128
position_d_gain              80      2  rw      +        4000            0       16383  1/16
position_i_gain              82      2  rw      +           0            0       16383  1/65536
position_p_gain              84      2  rw      +         640            0       16383  1/128
feedforward_2nd_gain         88      2  rw      +           0            0       16383  1/4
feedforward_1st_gain         90      2  rw      +           0            0       16383  1/4
bus_watchdog                 98      1  rw      +-          0            0         127  20 ms
goal_pwm                    100      2  rw      +-        885         -885         885  1/885
goal_velocity               104      4  rw      +-          0        -1023        1023  0.229 rpm
profile_acceleration        108      4  rw      +           0            0       32767  214.577 rev/min^2
profile_velocity            112      4  rw      +           0            0       32767  0.229 rpm
goal_position               116      4  rw      +-          0     -1048575     1048575  count
realtime_tick               120      2  r       +           0            0       32767  ms
moving                      122      1  r       +           0            0           1  1
moving_status               123      1  r       +           0            0         255  bits
present_pwm                 124      2  r       +-          0         -885         885  1/885
present_load                126      2  r       +-          0        -1000        1000  0.1 %
present_velocity            128      4  r       +-          0  -2147483648  2147483647  0.229 rpm
present_position            132      4  r       +-          0  -2147483648  2147483647  count
velocity_trajectory         136      4  r       +-          0  -2147483648  2147483647  0.229 rpm
position_trajectory         140      4  r       +-          0  -2147483648  2147483647  count
present_input_voltage       144      2  r       +           0            0       65535  0.1 V
present_temperature         146      1  r       +           0            0         255  degC
backup_ready                147      1  r       +           0            0           1  1
"""


def _registers() -> Iterator[Register]:
    for row in _ROWS.strip().splitlines()[1:]:
        name, address, size, access, sign, *numbers, _ = row.split(maxsplit=8)
        initial, low, high = map(int, numbers)
        writable, signed = access == "rw", sign == "+-"
        yield Register(
            name, int(address), int(size), writable, initial, low, high, signed
        )


REGISTERS = tuple(_registers())

TABLE: dict[str, Register] = {register.name: register for register in REGISTERS}

# register of every defined byte
BY_ADDRESS: dict[int, Register] = {
    address: register
    for register in REGISTERS
    for address in range(register.address, register.end)
}


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
        if register is not None
        and address <= register.address
        and register.end <= end
    }
