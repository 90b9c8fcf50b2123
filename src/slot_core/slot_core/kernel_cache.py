"""Cache of compiled kernels on disk, which all copies of the sources of one user share.

A file holds one kernel for one set of argument types. Its name is a digest of all that its content depends on:
the sources that the kernel's module imports from SLOT's packages, directly or not; the fields of the types; the
versions of Python, Numba, LLVM and NumPy; the settings of Numba; the processor. Numba's own cache asks for the
kernel's file and the types' names alone. The file begins with a digest of its content: a damaged one counts as
missing. Those not used for longest are removed when all together exceed LIMIT.
"""

import functools
import hashlib
import os
import pickle
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core import types
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

LIMIT = 500e6  # bytes; the kernels of a walk take some 20 MB, those of all tests some 60 MB
SUFFIX = ".kernel"
DIGEST = hashlib.sha256().digest_size
CONFIG: Any = numba.config  # its attributes are set at run time
# of Numba
SETTINGS = (
    "BOUNDSCHECK",
    "DEBUGINFO_DEFAULT",
    "LOOP_VECTORIZE",
    "OPT",
    "SLP_VECTORIZE",
)
IMPORT = re.compile(
    r"^(?:from|import) (slot_[\w.]*)(?: import (\([^)]*\)|[^\n]*))?",
    re.MULTILINE,
)


class KernelCache(NullCache):
    """Cache of one kernel, in the form that Numba's dispatcher asks for."""

    # Of all kernels of this process: when the first began to compile, s; why one could not be kept.
    began: float | None = None
    lost: OSError | None = None

    def __init__(self, function: Callable[..., Any]) -> None:
        self.name = f"{function.__module__}.{function.__qualname__}"
        self._function = function

    def path(self, signature: tuple[types.Type, ...], target: Any) -> Path:
        """File of the kernel for types of arguments, on the processor of a target."""
        key = (
            self.name,
            _described(signature),
            target.codegen().magic_tuple(),
            self._function.__code__.co_code,
            dumps(
                [
                    cell.cell_contents
                    for cell in self._function.__closure__ or ()
                ]
            ),
            [(name, getattr(CONFIG, name)) for name in SETTINGS],
            sys.version_info[:2],
            (numba.__version__, llvmlite.__version__, np.__version__),
            _sources(self._function.__module__),
        )
        return (
            folder()
            / f"{self.name}-{hashlib.sha256(repr(key).encode()).hexdigest()[:24]}{SUFFIX}"
        )

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """A compiled kernel, or None."""
        target_context.refresh()
        path = self.path(sig, target_context)
        try:
            data = path.read_bytes()
            if data[:DIGEST] == hashlib.sha256(data[DIGEST:]).digest():
                os.utime(path)  # used now
                return CompileResult._rebuild(
                    target_context, *pickle.loads(data[DIGEST:])
                )
        except OSError:
            pass
        self._announce()
        return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled kernel, where its folder can be written.

        Raises
        ------
        ValueError
            If the machine code holds an address of this process.
        """
        if data.library.has_dynamic_globals or data.lifted:
            raise ValueError(
                f"the kernel {self.name} refers to an object of this process: it cannot be kept"
            )
        content = dumps(data._reduce())
        path = self.path(sig, data.target_context)
        try:
            _write(path, hashlib.sha256(content).digest() + content)
            prune(path.parent)
        except OSError as error:  # read-only or full, as _announce says
            KernelCache.lost = error

    def _announce(self) -> None:
        """Say what is compiled: some ten kernels of a walk, a minute or two in all."""
        now = time.perf_counter()
        if KernelCache.began is None:
            KernelCache.began = now
            kept = (
                f"once; kept in {folder()}"
                if _writable(folder())
                else f"{folder()} cannot be written, so every start does"
            )
            _say(
                f"compiling kernels for this processor, a minute or two ({kept})"
            )
        _say(f"compiling {self.name}, after {now - KernelCache.began:.0f} s")


def folder() -> Path:
    """Folder of the kernels: NUMBA_CACHE_DIR, or slot/kernels in the user's cache."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    return Path(CONFIG.CACHE_DIR or Path(home, "slot", "kernels"))


def prune(kernels: Path, limit: float = LIMIT) -> None:
    """Remove the files that were not used for longest, until all together are within a limit (bytes)."""
    found = []
    for path in kernels.glob(f"*{SUFFIX}"):
        try:
            found.append((path.stat().st_mtime, path.stat().st_size, path))
        except FileNotFoundError:  # another process has removed it
            continue
    size = sum(entry[1] for entry in found)
    for _, one, path in sorted(found):
        if size <= limit:
            break
        path.unlink(missing_ok=True)
        size -= one


def _write(path: Path, data: bytes) -> None:
    """Write a file so that no other process sees a part of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        part.write_bytes(data)
        part.replace(path)
    except OSError:
        part.unlink(missing_ok=True)
        raise


def _writable(directory: Path) -> bool:
    try:
        directory.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=directory) as file:
            file.write(bytes(1 << 20))  # on a full disk an empty file would do
            return True
    except OSError:
        return False


def _say(text: str) -> None:
    print(f"slot_core: {text}", file=sys.stderr, flush=True)


def _described(value: Any) -> str:
    """Text of a Numba type with the names of its fields, or of a sequence of types."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_described, value))})"
    if isinstance(value, types.BaseNamedTuple):
        named: Any = value
        fields = [
            f"{n}: {_described(t)}"
            for n, t in zip(named.fields, named.types, strict=True)
        ]
        return f"{named.instance_class.__qualname__}({', '.join(fields)})"
    if isinstance(value, (types.Tuple, types.UniTuple)):
        return _described(tuple(value.types))
    return str(value)


@functools.cache
def _sources(module: str) -> str:
    """Digest of the sources of a module and of those that it imports from SLOT's packages."""
    found = {Path(str(sys.modules[module].__file__))}
    left = list(found)
    while left:
        new = set(_imported(left.pop())) - found
        found |= new
        left += new
    return hashlib.sha256(
        b"\0".join(sorted(path.read_bytes() for path in found))
    ).hexdigest()


def _imported(path: Path) -> Iterator[Path]:
    """Files of SLOT's packages that a file imports at its top level."""
    for name, members in IMPORT.findall(path.read_text(encoding="utf-8")):
        for full in (
            name,
            *(f"{name}.{member}" for member in re.findall(r"\w+", members)),
        ):
            if file := getattr(sys.modules.get(full), "__file__", None):
                yield Path(file)
