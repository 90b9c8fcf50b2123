"""Control table of an emulated servo: reading and writing with its access rules and error numbers.

A write is executed completely or not at all. Error numbers (ROBOTIS e-manual, Protocol 2.0):

    4  value outside the register's range; a goal while the bus watchdog has tripped
    5  part of a register
    6  value outside a limit held by another register
    7  address undefined or not writable; EEPROM while torque is on
"""

from slot_core.dynamixel.packet import Error
from slot_core.dynamixel.table import (
    BY_ADDRESS,
    INDIRECT_BANKS,
    INDIRECT_COUNT,
    RAM_START,
    REGISTERS,
    TABLE,
    TABLE_END,
    Mode,
    Register,
)

GOALS = ("goal_pwm", "goal_velocity", "goal_position")
TRIPPED = -1  # value of Bus Watchdog after it has tripped


class RegisterError(Exception):
    """A rejected instruction; `number`: error number of the status packet."""

    def __init__(self, number: Error) -> None:
        super().__init__(number.name)
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
        targets = [self._target(a) for a in range(address, address + size)]
        if not targets or any(target not in BY_ADDRESS for target in targets):
            raise RegisterError(Error.ACCESS)
        return bytes(self._bytes[target] for target in targets)

    def write(self, address: int, data: bytes) -> None:
        """Write bytes from an address; raises RegisterError and then changes nothing."""
        for register, value in self.checked(address, data).items():
            self[register] = value

    def checked(self, address: int, data: bytes) -> dict[str, int]:
        """Values that a write would set, by register name; raises RegisterError."""
        if not data:
            raise RegisterError(Error.DATA_LENGTH)
        new = {self._target(address + k): byte for k, byte in enumerate(data)}
        registers = dict.fromkeys(BY_ADDRESS.get(target) for target in new)
        values = {}
        for register in registers:
            if (
                register is None
                or not register.writable
                or (register.eeprom and self["torque_enable"])
            ):
                raise RegisterError(Error.ACCESS)
            own = range(register.address, register.end)
            if any(target not in new for target in own):
                raise RegisterError(Error.DATA_LENGTH)
            values[register.name] = register.decode(
                bytes(new[target] for target in own)
            )
            self._check(register, values[register.name])
        return values

    def _target(self, address: int) -> int:
        """Address accessed: for indirect data the one in its indirect address, else the same."""
        for first, data in INDIRECT_BANKS:
            if data <= address < data + INDIRECT_COUNT:
                pointer = first + 2 * (address - data)
                target = int.from_bytes(
                    self._bytes[pointer : pointer + 2], "little"
                )
                return target if _mappable(target) else address
        return address

    def _check(self, register: Register, value: int) -> None:
        name = register.name
        refused = name in GOALS or (name == "bus_watchdog" and value)
        if (
            not register.low <= value <= register.high
            or (name == "operating_mode" and value not in set(Mode))
            or (refused and self["bus_watchdog"] == TRIPPED)
        ):
            raise RegisterError(Error.DATA_RANGE)
        low, high = self.limits(name)
        if not low <= value <= high:
            raise RegisterError(Error.DATA_LIMIT)

    def limits(self, name: str) -> tuple[int, int]:
        """Limits of a register held by other registers; its own range if there are none."""
        if name in ("goal_pwm", "goal_velocity"):
            limit = self[name.removeprefix("goal_") + "_limit"]
            return -limit, limit
        if name == "goal_position" and self["operating_mode"] == Mode.POSITION:
            return self["min_position_limit"], self["max_position_limit"]
        return TABLE[name].low, TABLE[name].high


def _mappable(address: int) -> bool:
    """Whether indirect data may be an alias of this address: RAM, but not indirect data."""
    return address >= RAM_START and not any(
        data <= address < data + INDIRECT_COUNT for _, data in INDIRECT_BANKS
    )
