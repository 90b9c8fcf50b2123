"""Errors of bags."""


class BagError(ValueError):
    """A bag that cannot be read or written; the message is one line with its path and the cause."""


class NoFieldError(BagError):
    """The messages of a topic have no field of that name."""
