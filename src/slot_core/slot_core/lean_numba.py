"""Imports Numba without SciPy and coverage, which it loads where they are installed.

Kernels use neither, and every program would take a quarter of a second more to start. Imported
before Numba by `compiled` and `elementary`, through which all kernels come. A kernel of a user's
own that calls BLAS loads SciPy then.
"""

import sys
from typing import Any

MODULES: dict[str, Any] = sys.modules
ABSENT = {"coverage", "scipy"} - MODULES.keys()
MODULES |= dict.fromkeys(ABSENT)  # which lets their import fail; Numba allows for that
from numba.np import arraymath  # noqa: E402 - else imported with the first kernel

arraymath._HAVE_BLAS = True  # as where SciPy is found
for _name in ABSENT:
    del MODULES[_name]
