"""Compilation of kernels with Numba; `kernel_cache` keeps them.

A kernel is compiled, or read from the cache, at its first call with arguments of some types.
Whoever calls kernels while the robot moves has called each of them once in its constructor.

Numba is imported without SciPy and coverage, which it loads where they are installed: kernels use
neither, and every program would take a quarter of a second more to start. So a module imports this
one before Numba. A kernel of a user that calls BLAS loads SciPy then.
"""

# ruff: noqa: E402 - the order of the imports matters

import sys
from collections.abc import Callable
from typing import Any, TypeVar

MODULES: dict[str, Any] = sys.modules
ABSENT = {"coverage", "scipy"} - MODULES.keys()
# which lets their import fail; Numba allows for that
MODULES |= dict.fromkeys(ABSENT)
import numba
from numba.np import arraymath  # else imported with the first kernel

arraymath._HAVE_BLAS = True  # as where SciPy is found
for _name in ABSENT:
    del MODULES[_name]

from slot_core.kernel_cache import KernelCache

# the type annotations of numba.njit lack some of its options
njit: Any = numba.njit
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


def kernel(function: F, **options: Any) -> F:
    """Compile a function that Python calls, with a cache on disk."""
    dispatcher = njit(**OPTIONS, **options)(function)
    dispatcher._cache = KernelCache(function)
    return dispatcher


def unlocked_kernel(function: F) -> F:
    """As `kernel`; threads of Python run it side by side.

    It gives up Python's lock, which a thread of the controller may have to wait for afterwards.
    """
    return kernel(function, nogil=True)
