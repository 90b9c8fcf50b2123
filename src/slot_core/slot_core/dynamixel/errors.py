"""Errors of the servo bus; messages name the servo and the cause."""

from __future__ import annotations


class ServoError(Exception):
    """Base class of the errors of the servo bus."""


class PortError(ServoError):
    """The port cannot be opened or set up, or has disappeared (unplugged)."""


class BaudRateError(PortError):
    """The port does not support a baud rate."""


class CommunicationError(ServoError):
    """No valid answer of a servo after all retries; the message has the SDK's text."""


class InstructionError(ServoError):
    """A servo answered with an error number (it has not executed the instruction).

    Also: a register holds another value than the one written.
    """


class RefusedError(ServoError):
    """An action was refused because of the servos' state or set-up; `reasons`: one line each."""

    def __init__(self, reasons: list[str]) -> None:
        super().__init__("; ".join(reasons))
        self.reasons = tuple(reasons)
