"""What can go wrong on the servo bus, each with the servo's name and the cause."""

from __future__ import annotations


class ServoError(Exception):
    """Base of all errors of the servo bus."""


class PortError(ServoError):
    """The port cannot be opened or set up, or has gone (unplugged)."""


class CommunicationError(ServoError):
    """A servo did not answer, or its answer was damaged, after all retries; the SDK's words."""


class InstructionError(ServoError):
    """A servo answered with an error number: it has not done what it was asked."""


class RefusedError(ServoError):
    """The servos are not as they must be; `reasons` holds one line for each thing wrong."""

    def __init__(self, reasons: list[str]) -> None:
        super().__init__("; ".join(reasons))
        self.reasons = tuple(reasons)
