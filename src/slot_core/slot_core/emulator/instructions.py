"""What an emulated servo does with an instruction; error numbers as in `memory.py`."""

from __future__ import annotations

from collections.abc import Callable

from slot_core.dynamixel.packet import BROADCAST, Error, Instruction, Packet
from slot_core.dynamixel.table import MODEL_NUMBER
from slot_core.emulator.emulated_servo import EmulatedServo
from slot_core.emulator.memory import RegisterError

CLEAR_TURNS = b"\x01\x44\x58\x4c\x22"  # parameters of Clear
KEPT = {0xFF: (), 0x01: ("id",), 0x02: ("id", "baud_rate")}  # by parameter of Factory Reset


def word(data: bytes) -> int:
    """The number in two bytes."""
    return int.from_bytes(data, "little")


def execute(each: EmulatedServo, packet: Packet) -> tuple[int, bytes]:
    """Error byte and data with which a servo answers; it has done then what it was asked."""
    try:
        action = _ACTIONS.get(packet.instruction)
        if action is None:
            raise RegisterError(Error.INSTRUCTION)
        data = action(each, packet)
    except RegisterError as refusal:
        return each.error | refusal.number, b""
    return each.error, data


def read_data(each: EmulatedServo, address: int, size: int) -> tuple[int, bytes]:
    """Error byte and data with which a servo answers in a sync or bulk read."""
    try:
        return each.error, each.read(address, size)
    except RegisterError as refusal:
        return each.error | refusal.number, b""


def _on_ping(each: EmulatedServo, packet: Packet) -> bytes:
    return MODEL_NUMBER.to_bytes(2, "little") + bytes([each.memory["firmware_version"]])


def _on_read(each: EmulatedServo, packet: Packet) -> bytes:
    if len(packet.parameters) != 4 or packet.id == BROADCAST:
        raise RegisterError(Error.DATA_LENGTH)
    return each.read(word(packet.parameters[:2]), word(packet.parameters[2:]))


def _on_write(each: EmulatedServo, packet: Packet) -> bytes:
    if len(packet.parameters) < 3:
        raise RegisterError(Error.DATA_LENGTH)
    each.write(word(packet.parameters[:2]), packet.parameters[2:])
    return b""


def _on_reg_write(each: EmulatedServo, packet: Packet) -> bytes:
    if len(packet.parameters) < 3:
        raise RegisterError(Error.DATA_LENGTH)
    address, data = word(packet.parameters[:2]), packet.parameters[2:]
    each.memory.checked(address, data)
    each.registered = (address, data)
    each.memory["registered_instruction"] = 1
    return b""


def _on_action(each: EmulatedServo, packet: Packet) -> bytes:
    if each.registered is None:
        raise RegisterError(Error.INSTRUCTION)
    (address, data), each.registered = each.registered, None
    each.memory["registered_instruction"] = 0
    each.write(address, data)
    return b""


def _on_factory_reset(each: EmulatedServo, packet: Packet) -> bytes:
    kept = KEPT.get(packet.parameters[0]) if len(packet.parameters) == 1 else None
    if kept is None or (packet.id == BROADCAST and not kept):
        raise RegisterError(Error.DATA_RANGE)
    each.factory_reset(kept)
    return b""


def _on_reboot(each: EmulatedServo, packet: Packet) -> bytes:
    each.reboot()
    return b""


def _on_clear(each: EmulatedServo, packet: Packet) -> bytes:
    if packet.parameters != CLEAR_TURNS:
        raise RegisterError(Error.DATA_RANGE)
    if each.moving():
        raise RegisterError(Error.RESULT_FAIL)
    each.clear_turns()
    return b""


def _need_broadcast(packet: Packet) -> None:
    if packet.id != BROADCAST:
        raise RegisterError(Error.INSTRUCTION)


def _on_sync_write(each: EmulatedServo, packet: Packet) -> bytes:
    _need_broadcast(packet)
    parameters = packet.parameters
    address, size = word(parameters[:2]), word(parameters[2:4])
    for start in range(4, len(parameters) - size, size + 1):
        if parameters[start] == each.memory["id"]:
            each.write(address, parameters[start + 1 : start + 1 + size])
            break
    return b""


def _on_bulk_write(each: EmulatedServo, packet: Packet) -> bytes:
    _need_broadcast(packet)
    rest = packet.parameters
    while len(rest) >= 5:
        size = word(rest[3:5])
        if rest[0] == each.memory["id"] and len(rest) >= 5 + size:
            each.write(word(rest[1:3]), rest[5 : 5 + size])
            break
        rest = rest[5 + size :]
    return b""


_ACTIONS: dict[int, Callable[[EmulatedServo, Packet], bytes]] = {
    Instruction.PING: _on_ping,
    Instruction.READ: _on_read,
    Instruction.WRITE: _on_write,
    Instruction.REG_WRITE: _on_reg_write,
    Instruction.ACTION: _on_action,
    Instruction.FACTORY_RESET: _on_factory_reset,
    Instruction.REBOOT: _on_reboot,
    Instruction.CLEAR: _on_clear,
    Instruction.SYNC_WRITE: _on_sync_write,
    Instruction.BULK_WRITE: _on_bulk_write,
}
