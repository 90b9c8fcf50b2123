"""Instructions of Protocol 2.0 on an emulated servo; error numbers: `memory.py`.

Factory Reset, Clear and the bulk instructions are answered as unknown: no driver here sends them.
"""

from collections.abc import Callable

from slot_core.dynamixel.emulator.emulated_servo import EmulatedServo
from slot_core.dynamixel.emulator.memory import RegisterError
from slot_core.dynamixel.packet import BROADCAST, Error, Instruction, Packet
from slot_core.dynamixel.table import MODEL_NUMBER


def uint16(data: bytes) -> int:
    """Unsigned number in two bytes."""
    return int.from_bytes(data, "little")


def execute(servo: EmulatedServo, packet: Packet) -> tuple[int, bytes]:
    """Execute an instruction other than a sync read; error byte and data of the answer."""
    try:
        action = _ACTIONS.get(packet.instruction)
        if action is None:
            raise RegisterError(Error.INSTRUCTION)
        data = action(servo, packet)
    except RegisterError as rejection:
        return servo.error | rejection.number, b""
    return servo.error, data


def read_data(
    servo: EmulatedServo, address: int, size: int
) -> tuple[int, bytes]:
    """Error byte and data of a servo's answer to a sync read."""
    try:
        return servo.error, servo.read(address, size)
    except RegisterError as rejection:
        return servo.error | rejection.number, b""


def _on_ping(servo: EmulatedServo, packet: Packet) -> bytes:
    return MODEL_NUMBER.to_bytes(2, "little") + bytes(
        [servo.memory["firmware_version"]]
    )


def _on_read(servo: EmulatedServo, packet: Packet) -> bytes:
    if len(packet.parameters) != 4 or packet.id == BROADCAST:
        raise RegisterError(Error.DATA_LENGTH)
    return servo.read(
        uint16(packet.parameters[:2]), uint16(packet.parameters[2:])
    )


def _on_write(servo: EmulatedServo, packet: Packet) -> bytes:
    if len(packet.parameters) < 3:
        raise RegisterError(Error.DATA_LENGTH)
    servo.write(uint16(packet.parameters[:2]), packet.parameters[2:])
    return b""


def _on_reg_write(servo: EmulatedServo, packet: Packet) -> bytes:
    if len(packet.parameters) < 3:
        raise RegisterError(Error.DATA_LENGTH)
    address, data = uint16(packet.parameters[:2]), packet.parameters[2:]
    servo.memory.checked(address, data)
    servo.registered = (address, data)
    servo.memory["registered_instruction"] = 1
    return b""


def _on_action(servo: EmulatedServo, packet: Packet) -> bytes:
    if servo.registered is None:
        raise RegisterError(Error.INSTRUCTION)
    (address, data), servo.registered = servo.registered, None
    servo.memory["registered_instruction"] = 0
    servo.write(address, data)
    return b""


def _on_reboot(servo: EmulatedServo, packet: Packet) -> bytes:
    servo.reboot()
    return b""


def _on_sync_write(servo: EmulatedServo, packet: Packet) -> bytes:
    if packet.id != BROADCAST:
        raise RegisterError(Error.INSTRUCTION)
    parameters = packet.parameters
    address, size = uint16(parameters[:2]), uint16(parameters[2:4])
    for start in range(4, len(parameters) - size, size + 1):
        if parameters[start] == servo.memory["id"]:
            servo.write(address, parameters[start + 1 : start + 1 + size])
            break
    return b""


_ACTIONS: dict[int, Callable[[EmulatedServo, Packet], bytes]] = {
    Instruction.PING: _on_ping,
    Instruction.READ: _on_read,
    Instruction.WRITE: _on_write,
    Instruction.REG_WRITE: _on_reg_write,
    Instruction.ACTION: _on_action,
    Instruction.REBOOT: _on_reboot,
    Instruction.SYNC_WRITE: _on_sync_write,
}
