"""Compilation: how the kernels of this package are compiled and where the result is kept.

Numba notices a change in the file of a kernel, but not in a helper that the kernel calls. The cache
directory therefore carries a digest of all sources of this package in its name.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numba

SETTINGS: Any = numba.config  # filled at run time
F = TypeVar("F", bound=Callable[..., Any])

# `contract` fuses multiply and add. Full fastmath would let the compiler delete the checks for NaN.
# Without Numba's run time (nrt) a kernel that allocates memory does not compile, and none counts
# references to its arrays, which costs more than the arithmetic.
OPTIONS: dict[str, Any] = {"fastmath": {"contract"}, "error_model": "numpy", "_nrt": False}


def helper(function: F) -> F:
    """Compile a function that only kernels call, in line: a call would pass arrays in memory.

    Leaving out Python's wrappers halves the time of compilation.
    """
    options = OPTIONS | {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "forceinline": True}
    return numba.njit(**options)(function)


def kernel(function: F) -> F:
    """Compile a function that Python calls; keep the result on disk where that is possible."""
    before = SETTINGS.CACHE_DIR
    directory = _cache_directory()
    SETTINGS.CACHE_DIR = str(directory or "")
    try:
        return numba.njit(cache=directory is not None, **OPTIONS)(function)
    finally:
        SETTINGS.CACHE_DIR = before


def _cache_directory() -> Path | None:
    """A writable directory for the present sources, or None: then every start compiles afresh."""
    try:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        root = SETTINGS.CACHE_DIR or Path(home) / "slot"
        directory = Path(root) / f"dynamics-{_digest()}"
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            return directory
    except (OSError, RuntimeError):  # no home, read-only, full
        return None


def _digest() -> str:
    sources = sorted(Path(__file__).parent.glob("*.py"))
    return hashlib.sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()[:16]
