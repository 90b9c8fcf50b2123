"""Refusals: errors of inputs, files and diverged motions, with messages of one short line.

Names and values in messages come from files, bags, packets and command lines. A library's message
may repeat a value of many megabytes, and a text may hold sequences that command a terminal. So a
message has no control characters and a bounded length.

A file that a user names is read only if it is regular and not too large: a device may have no end,
and opening a pipe waits for whoever writes to it.
"""

import difflib
import reprlib
import stat
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

LINE_MAX = 300  # characters of a message
VALUE_MAX = 80  # characters of a quoted value
CUT = " ... "
LFS_POINTER = b"version https://git-lfs"  # begin of such a file


class InputError(ValueError):
    """An input that cannot be used; the message is one line of at most LINE_MAX characters."""

    def __init__(self, message: object = "") -> None:
        super().__init__(one_line(message))


class DivergenceError(ArithmeticError):
    """The motion of a rod or robot has diverged; the message names time and place if known.

    `state` holds the values of `SimulatedRobot.snapshot` by name; of a rod it is empty.
    """

    def __init__(
        self, message: str, state: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(message)
        self.state = dict(state or {})

    def save(self, path: Path, scene: str) -> None:
        """Write state, message and the scene's name for `numpy.load`; raises OSError."""
        import numpy as np  # noqa: PLC0415 - a help needs no NumPy

        path.parent.mkdir(parents=True, exist_ok=True)
        np.savez(path, scene=scene, message=str(self), **self.state)


def one_line(message: object) -> str:
    """A message or an error's text as one printable line; the middle of a long one is cut."""
    text = str(message)
    # what is cut away is neither split nor escaped
    if len(text) > 4 * LINE_MAX:
        text = f"{text[: 2 * LINE_MAX]}{CUT}{text[-2 * LINE_MAX :]}"
    return _cut(printable(" ".join(text.split())), LINE_MAX)


def quoted(value: Any) -> str:
    """A refused value as in Python, printable; a long one is cut."""
    return _cut(_SHORT.repr(value), VALUE_MAX)


def printable(text: str) -> str:
    """The text with control characters, and others that are not printable, as escape sequences."""
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def nearest(name: str, known: Iterable[str]) -> str:
    """` (nearest: a, b)`: the names like an unknown one, by whole or last part; else ` (known: ...)`."""
    names = list(known)
    near = [each for each in names if each.endswith(f".{name}")]
    near = near or difflib.get_close_matches(name, names)
    listed = ", ".join(near or names)
    return f" (nearest: {listed})" if near else f" (known: {listed})"


class _Short(reprlib.Repr):
    """Looks at the first elements of a collection only."""

    def repr_int(self, x: int, level: int) -> str:
        """Python refuses to print very long integers."""
        return (
            repr(x)
            if x.bit_length() <= 64
            else f"an integer of {x.bit_length()} bits"
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


def require_regular(path: Path) -> None:
    """Raise ValueError for a directory, a device, a pipe or a Git LFS pointer.

    Raises OSError if there is nothing to read.
    """
    if not stat.S_ISREG(path.stat().st_mode):
        raise ValueError("not a regular file")
    with path.open("rb") as stream:
        if stream.read(len(LFS_POINTER)) == LFS_POINTER:
            raise ValueError(
                "a pointer of Git LFS in place of the file: git lfs pull"
            )


def read_bytes(path: Path, most: int) -> bytes:
    """Content of a regular file of at most `most` bytes; raises OSError, ValueError."""
    require_regular(path)
    with path.open("rb") as stream:
        content = stream.read(most + 1)  # some files of /proc have no size
    if len(content) > most:
        raise ValueError(f"more than {most} bytes")
    return content


def read_text(path: Path, most: int) -> str:
    """Text of a file in UTF-8, as `read_bytes`; a byte order mark is left out."""
    return read_bytes(path, most).decode("utf-8-sig")
