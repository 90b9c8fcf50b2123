"""Compilation with Numba: how kernels are compiled and where the result is kept.

Numba notices a change in the file of a kernel, but not in a helper that the kernel calls. The cache
directory therefore carries a digest of all sources that belong together in its name.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import numba

SETTINGS: Any = numba.config  # filled at run time
njit: Any = numba.njit  # its annotations lack some of its options
F = TypeVar("F", bound=Callable[..., Any])

# Without Numba's run time (nrt) a kernel that allocates memory does not compile, and none counts
# references to its arrays, which costs more than the arithmetic.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}


def compile_helper(function: F, **options: Any) -> F:
    """Compile a function that only kernels call, in line: a call would pass arrays in memory.

    Leaving out Python's wrappers halves the time of compilation.
    """
    inside: dict[str, Any] = {
        "no_cpython_wrapper": True,
        "no_cfunc_wrapper": True,
        "forceinline": True,
    }
    return njit(**OPTIONS, **inside, **options)(function)


def compile_kernel(function: F, name: str, sources: Iterable[Path], **options: Any) -> F:
    """Compile a function that Python calls; keep the result on disk where that is possible.

    name: of what the `sources` make up, for the directory in the cache.
    """
    before = SETTINGS.CACHE_DIR
    directory = _cache_directory(name, sources)
    SETTINGS.CACHE_DIR = str(directory or "")
    try:
        return njit(cache=directory is not None, **OPTIONS, **options)(function)
    finally:
        SETTINGS.CACHE_DIR = before


def _cache_directory(name: str, sources: Iterable[Path]) -> Path | None:
    """A writable directory for the present sources, or None: then every start compiles afresh."""
    try:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        root = SETTINGS.CACHE_DIR or Path(home) / "slot"
        text = b"".join(path.read_bytes() for path in sorted(sources))
        directory = Path(root) / f"{name}-{hashlib.sha256(text).hexdigest()[:16]}"
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            return directory
    except (OSError, RuntimeError):  # no home, read-only, full
        return None
