"""Errors of a servo bus; messages name the servo and the cause."""

from __future__ import annotations


class ServoError(Exception):
    """Base class of the errors of a servo bus."""


class PortError(ServoError):
    """The port cannot be opened or set up, or has disappeared (unplugged)."""


class RefusedError(ServoError):
    """An action was refused because of the servos' state or set-up; `reasons`: one line each."""

    def __init__(self, reasons: list[str]) -> None:
        super().__init__("; ".join(reasons))
        self.reasons = tuple(reasons)
