"""Writes a stride as a file of `config/gait`."""

from __future__ import annotations

import dataclasses
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from slot_core.gait.gait import Stride

WIDTH = 98  # of the comment's text
DECIMALS = 9  # of values; smaller ones are zero


def write(path: Path, stride: Stride, head: Sequence[str]) -> None:
    """Write a stride; head: lines of the comment before it. Raises OSError."""
    lines = [
        f"# {part}" for line in head for part in textwrap.wrap(line, WIDTH) or [""]
    ]
    path.write_text("\n".join([*lines, *_lines(stride, "")]) + "\n")


def _lines(settings: Any, indent: str) -> Iterator[str]:
    """Lines of a settings object: values first, then nested objects, rows of matrices in a line."""
    fields = [
        (field.name, getattr(settings, field.name))
        for field in dataclasses.fields(settings)
    ]
    for name, value in sorted(
        fields, key=lambda item: dataclasses.is_dataclass(item[1])
    ):
        if dataclasses.is_dataclass(value):
            yield f"{indent}{name}:"
            yield from _lines(value, indent + "  ")
        elif isinstance(value, tuple) and isinstance(value[0], tuple):
            yield f"{indent}{name}:"
            yield from (f"{indent}  - {_text(row)}" for row in value)
        else:
            yield f"{indent}{name}: {_text(value)}"


def _text(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(map(_text, value)) + "]"
    return (
        f"{round(value, DECIMALS) + 0.0:.4g}"
        if isinstance(value, float)
        else str(value)
    )
