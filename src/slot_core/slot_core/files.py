"""Files that users name: read only if they are regular and not too large.

A device may have no end, and opening a pipe waits for whoever writes to it.
"""

from __future__ import annotations

import stat
from pathlib import Path

ONNX = "onnx:"  # what the name of a policy begins with that is the file of a network


def require_regular(path: Path) -> None:
    """Raise ValueError for a directory, a device or a pipe, OSError if there is nothing."""
    if not stat.S_ISREG(path.stat().st_mode):
        raise ValueError("not a regular file")


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
