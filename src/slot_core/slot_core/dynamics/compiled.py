"""How the kernels of this package are compiled."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

from slot_core import compiled

SETTINGS = compiled.SETTINGS
F = TypeVar("F", bound=Callable[..., Any])

# `contract` fuses multiply and add. Full fastmath would let the compiler delete the checks for NaN.
FAST: dict[str, Any] = {"fastmath": {"contract"}}
OPTIONS: dict[str, Any] = FAST | compiled.OPTIONS


def helper(function: F) -> F:
    """Compile a function that only kernels call."""
    return compiled.compile_helper(function, **FAST)


def kernel(function: F) -> F:
    """Compile a function that Python calls."""
    return compiled.compile_kernel(function, "dynamics", Path(__file__).parent.glob("*.py"), **FAST)
