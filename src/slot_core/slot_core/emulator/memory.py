"""The control table of an emulated servo: what may be read and written, and with which error.

A write is done as a whole or not at all. Error numbers as in ROBOTIS' e-manual, Protocol 2.0: a
number outside the table's range 4, part of a register 5, outside a limit that another register
holds 6, an address that is not defined or not writable, or EEPROM while torque is on 7. Goals while
the bus watchdog has tripped: 4.
"""

from __future__ import annotations

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
TRIPPED = -1  # value of the bus watchdog


class RegisterError(Exception):
    """A refused read or write; `number` goes into the status packet."""

    def __init__(self, number: Error) -> None:
        super().__init__(number.name)
        self.number = number


class Memory:
    """Registers of one servo."""

    def __init__(self) -> None:
        self._bytes = bytearray(TABLE_END)
        for register in REGISTERS:
            self[register.name] = register.initial

    def __getitem__(self, name: str) -> int:
        register = TABLE[name]
        return register.decode(bytes(self._bytes[register.address : register.end]))

    def __setitem__(self, name: str, value: int) -> None:
        register = TABLE[name]
        self._bytes[register.address : register.end] = register.encode(value)

    def image(self) -> bytes:
        """All bytes, to be put back by `load`."""
        return bytes(self._bytes)

    def load(self, image: bytes) -> None:
        """Put back what `image` gave."""
        self._bytes[:] = image

    def reset(self, eeprom: bool, keep: tuple[str, ...] = ()) -> None:
        """Initial values in RAM, and in EEPROM but for `keep` if asked; what is read only stays."""
        for register in REGISTERS:
            if (eeprom or not register.eeprom) and register.writable and register.name not in keep:
                self[register.name] = register.initial

    def restore(self, name: str) -> None:
        """The initial value of a register."""
        self[name] = TABLE[name].initial

    def read(self, address: int, size: int) -> bytes:
        """Bytes from an address; raises RegisterError."""
        places = [self._place(a) for a in range(address, address + size)]
        if not places or any(place not in BY_ADDRESS for place in places):
            raise RegisterError(Error.ACCESS)
        return bytes(self._bytes[place] for place in places)

    def write(self, address: int, data: bytes) -> list[str]:
        """Write bytes if they may be; returns the registers' names, raises RegisterError."""
        values = self.checked(address, data)
        for register, value in values.items():
            self[register] = value
        return list(values)

    def checked(self, address: int, data: bytes) -> dict[str, int]:
        """What a write would change; raises RegisterError."""
        if not data:
            raise RegisterError(Error.DATA_LENGTH)
        new = {self._place(address + k): byte for k, byte in enumerate(data)}
        registers = dict.fromkeys(BY_ADDRESS.get(place) for place in new)
        values = {}
        for register in registers:
            if register is None or not self._writable(register):
                raise RegisterError(Error.ACCESS)
            places = range(register.address, register.end)
            if any(place not in new for place in places):
                raise RegisterError(Error.DATA_LENGTH)
            values[register.name] = register.decode(bytes(new[place] for place in places))
            self._check(register, values[register.name])
        return values

    def _place(self, address: int) -> int:
        """Where an address leads to: indirect data to the byte that its indirect address names."""
        for first, data in INDIRECT_BANKS:
            if data <= address < data + INDIRECT_COUNT:
                where = first + 2 * (address - data)
                target = int.from_bytes(self._bytes[where : where + 2], "little")
                return address if _indirect_data(target) else target
        return address

    def _writable(self, register: Register) -> bool:
        return register.writable and not (register.eeprom and self["torque_enable"])

    def _check(self, register: Register, value: int) -> None:
        name = register.name
        if not register.low <= value <= register.high:
            raise RegisterError(Error.DATA_RANGE)
        if name == "operating_mode" and value not in set(Mode):
            raise RegisterError(Error.DATA_RANGE)
        if self["bus_watchdog"] == TRIPPED and (
            name in GOALS or (name == "bus_watchdog" and value)
        ):
            raise RegisterError(Error.DATA_RANGE)
        low, high = self.limits(name)
        if not low <= value <= high:
            raise RegisterError(Error.DATA_LIMIT)

    def limits(self, name: str) -> tuple[int, int]:
        """Limits of a register that other registers hold; its own range where none does."""
        if name == "goal_pwm":
            return -self["pwm_limit"], self["pwm_limit"]
        if name == "goal_velocity":
            return -self["velocity_limit"], self["velocity_limit"]
        if name == "goal_position" and self["operating_mode"] == Mode.POSITION:
            return self["min_position_limit"], self["max_position_limit"]
        return TABLE[name].low, TABLE[name].high


def _indirect_data(address: int) -> bool:
    return address < RAM_START or any(
        data <= address < data + INDIRECT_COUNT for _, data in INDIRECT_BANKS
    )
