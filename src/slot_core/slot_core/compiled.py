"""Compilation of kernels with Numba, and the cache of compiled kernels.

Numba detects a change in the file of a kernel, but neither in a helper that the kernel calls nor in
the type of an argument. The name of the cache directory therefore contains a digest of all folders
of this package that the kernel's file imports from, directly or not. Their path is no part of it:
every installed copy of a source uses the kernels that scripts/setup has compiled.

A kernel is compiled, or read from the cache, at its first call with arguments of some types.
Whoever calls kernels while the robot moves has called each of them once in its constructor.
"""

from __future__ import annotations

import functools
import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

import slot_core.lean_numba  # noqa: F401  # isort: skip
import numba
from numba.core.caching import UserProvidedCacheLocator

SETTINGS: Any = numba.config  # its attributes are set at run time
njit: Any = numba.njit  # the type annotations of numba.njit lack some of its options
F = TypeVar("F", bound=Callable[..., Any])

# No fastmath: the compiler neither reorders nor fuses operations, so that every processor gives the
# same bits, and the checks for NaN stay.
# Without Numba's run time (nrt) a kernel that allocates memory does not compile, and none counts
# references to its arrays, which would cost more than the arithmetic.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}
# A helper is inlined, because a call would pass arrays in memory. Without Python's wrappers it
# compiles in half the time.
INLINE: dict[str, Any] = {
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
    "forceinline": True,
}


def helper(function: F) -> F:
    """Compile a function that only kernels call."""
    return njit(**OPTIONS, **INLINE)(function)


def kernel(function: F) -> F:
    """Compile a function that Python calls, with a cache on disk where that is possible."""
    return _kernel(function, {})


def unlocked_kernel(function: F) -> F:
    """As `kernel`; threads of Python run it side by side.

    It gives up Python's lock, which a thread of the controller may have to wait for afterwards.
    """
    return _kernel(function, {"nogil": True})


def _kernel(function: F, options: dict[str, Any]) -> F:
    before = SETTINGS.CACHE_DIR, SETTINGS.CACHE_LOCATOR_CLASSES
    directory = _cache_directory(function.__module__)
    SETTINGS.CACHE_DIR = str(directory or "")
    SETTINGS.CACHE_LOCATOR_CLASSES = f"{__name__}.{DirectoryItself.__name__}"
    try:
        return njit(cache=directory is not None, **OPTIONS, **options)(function)
    finally:
        SETTINGS.CACHE_DIR, SETTINGS.CACHE_LOCATOR_CLASSES = before


class DirectoryItself(UserProvidedCacheLocator):
    """Caches in CACHE_DIR itself; Numba adds a folder named after the path of the source."""

    def __init__(self, function: Callable[..., Any], file: str) -> None:
        super().__init__(function, file)
        self._cache_path = SETTINGS.CACHE_DIR


def _cache_directory(module: str) -> Path | None:
    """A writable cache directory for a module's kernels, or None: then every start recompiles."""
    try:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        root = SETTINGS.CACHE_DIR or Path(home) / "slot"
        folders = {Path(str(sys.modules[name].__file__)).parent for name in _imported(module)}
        text = b"".join(_sources(folder) for folder in sorted(folders))
        name = module.rpartition(".")[2]
        directory = Path(root) / f"{name}-{hashlib.sha256(text).hexdigest()[:16]}"
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory):
            return directory
    except (OSError, RuntimeError):  # no home, read-only, full
        return None


def _imported(module: str) -> set[str]:
    """Names of a module and of the modules of this package that it imports, directly or not."""
    package = f"{__name__.partition('.')[0]}."
    found, left = {module}, [module]
    while left:
        for value in vars(sys.modules[left.pop()]).values():
            name = value.__name__ if isinstance(value, ModuleType) else _home(value)
            if name.startswith(package) and name not in found:
                found.add(name)
                left.append(name)
    return found


def _home(value: Any) -> str:
    """Name of the module that defines a function or class, or an empty string."""
    name = getattr(value, "__module__", None)
    return name if isinstance(name, str) and name in sys.modules else ""


@functools.cache
def _sources(folder: Path) -> bytes:
    """Content of the Python files in a folder."""
    return b"".join(path.read_bytes() for path in sorted(folder.glob("*.py")))
