"""Places of the documentation, and Markdown from plain values."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(os.environ.get("SLOT_ROOT") or Path(__file__).resolve().parents[2])
DOC = ROOT / "slot_bringup" / "doc"
REFERENCE = DOC / "reference"  # folder of the generated pages
SPECIAL = re.compile(r"([\\`*_{}\[\]<>$|#])")


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of cells that are Markdown already."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines) + "\n"


def plain(text: str) -> str:
    """Text in one line that Markdown takes as it is."""
    return SPECIAL.sub(r"\\\1", " ".join(text.split()))


def code(value: Any) -> str:
    """A value in the fixed-width font; empty for None and an empty text."""
    text = format_value(value)
    return f"`{text}`" if text else ""


def format_value(value: Any) -> str:
    """A value as text: numbers with six digits, sequences with commas."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(format_value, value))}]"
    return str(value)


def link(text: str, path: Path) -> str:
    """A link from a page of the reference to a file."""
    return f"[{text}]({os.path.relpath(path, REFERENCE)})"
