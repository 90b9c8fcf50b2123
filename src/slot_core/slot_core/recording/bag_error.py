"""Errors of bags."""

from slot_core.refusal import InputError


class BagError(InputError):
    """A bag that cannot be read or written; the message has its path and the cause."""


class NoFieldError(BagError):
    """The messages of a topic have no field of that name."""
