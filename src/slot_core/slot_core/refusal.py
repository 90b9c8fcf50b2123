"""Messages of refusals: one short line, without control characters.

Names and values in them come from files, bags, packets and command lines. A library's message may
repeat a value of many megabytes, and a text may hold sequences that command a terminal.
"""

from __future__ import annotations

import reprlib
from typing import Any

LINE_MAX = 300  # characters of a message
VALUE_MAX = 80  # characters of a quoted value
CUT = " ... "


class InputError(ValueError):
    """An input that cannot be used; the message is one line of at most LINE_MAX characters."""

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(message))


def one_line(message: object) -> str:
    """A message or an error's text as one printable line; the middle of a long one is cut."""
    text = str(message)
    if len(text) > 4 * LINE_MAX:  # what is cut away is neither split nor escaped
        text = f"{text[: 2 * LINE_MAX]}{CUT}{text[-2 * LINE_MAX :]}"
    return _cut(printable(" ".join(text.split())), LINE_MAX)


def quoted(value: Any) -> str:
    """A refused value as in Python, printable; a long one is cut."""
    return _cut(_SHORT.repr(value), VALUE_MAX)


def printable(text: str) -> str:
    """The text with control characters, and others that are not printable, as escape sequences."""
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


class _Short(reprlib.Repr):
    """Looks at the first elements of a collection only."""

    def repr_int(self, x: int, level: int) -> str:
        """Python refuses to print very long integers."""
        return (
            repr(x) if x.bit_length() <= 64 else f"an integer of {x.bit_length()} bits"
        )


_SHORT = _Short()
_SHORT.maxstring = _SHORT.maxother = VALUE_MAX
_SHORT.maxlevel = 3


def _cut(text: str, most: int) -> str:
    """The text without its middle, of at most so many characters."""
    if len(text) <= most:
        return text
    end = most // 3
    return f"{text[: most - end - len(CUT)]}{CUT}{text[-end:]}"
