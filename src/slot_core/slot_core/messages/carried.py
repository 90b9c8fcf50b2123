"""Values on their way between nodes of one process, each in place of its message.

A decoder of `decode.py` returns the value itself. Whoever reads an attribute of the message, or
publishes it, has it made then, once. So value and arguments of `make` must not change any more.
"""

from collections.abc import Callable
from typing import Any


class Carried:
    """Value that `decode.py` would find in a message, the message's stamp (ns), and how it is made."""

    def __init__(
        self,
        stamp: int,
        value: Any,
        make: Callable[[], Any],
        encode: Callable[[], bytes] | None = None,
        **fields: Any,
    ) -> None:
        """encode: makes the message's CDR bytes without it, if there is a quicker way.

        fields: those of the message that are read so often that it is not made for them.
        """
        self.stamp, self.value, self._make = stamp, value, make
        self.encode = encode
        self._message: Any = None
        self.__dict__ |= fields

    def __getattr__(self, name: str) -> Any:
        """A field of the message."""
        return getattr(self.message, name)

    @property
    def message(self) -> Any:
        """The message."""
        if self._message is None:
            self._message = self._make()
        return self._message
