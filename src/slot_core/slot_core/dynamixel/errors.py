"""Errors of Dynamixel servos and their line, beside those of every servo bus."""

from __future__ import annotations

from slot_core.servos.servo_errors import PortError, ServoError


class BaudRateError(PortError):
    """The port does not support a baud rate."""


class CommunicationError(ServoError):
    """No valid answer of a servo after all retries; the message has the SDK's text."""


class InstructionError(ServoError):
    """A servo answered with an error number (it has not executed the instruction).

    Also: a register holds another value than the one written.
    """
