"""Same bits everywhere: the control path and the plant call nothing that differs by processor."""

import ast
import functools
import importlib
import os
import pkgutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import slot_core
from slot_core.control.policies import POLICIES
from slot_core.kernel_cache import KernelCache
from slot_core.simulation.closed_loop import ClosedLoop

CORE = Path(__file__).resolve().parents[1] / "src" / "slot_core" / "slot_core"
ROOMS = (
    "estimation",
    "gait",
    "control",
    "rollout_mpc",
    "mpc",
    "legs",
    "safety",
    "messages",
    "dynamics",
    "simulation",
)
GROUND = (
    "elementary",
    "matrices",
    "geometry",
    "robot",
    "arrays",
    "section",
    "clock",
)
# Files of these rooms that no node of the graph and no simulation of it runs, or that use OpenCV.
OUTSIDE = {
    "simulation/camera_sensor.py": "draws images with OpenCV",
    "control/onnx_policy.py": "runs a network by ONNX Runtime",
}
MATH = {
    "sqrt",
    "floor",
    "ceil",
    "inf",
    "nan",
    "pi",
    "tau",
    "isfinite",
    "isnan",
    "isinf",
    "radians",
    "degrees",
    "copysign",
    "ldexp",
}
# Functions of the C library that differ by processor, as NumPy and kernels call them.
C_LIBRARY = {
    "sin",
    "cos",
    "tan",
    "asin",
    "acos",
    "atan",
    "atan2",
    "sinh",
    "cosh",
    "tanh",
    "asinh",
    "acosh",
    "atanh",
    "exp",
    "exp2",
    "expm1",
    "log",
    "log2",
    "log10",
    "log1p",
    "pow",
    "hypot",
    "cbrt",
    "fma",
    "sincos",
}
NUMPY = (
    C_LIBRARY
    | {  # and those that call BLAS, LAPACK or code of their own by processor
        "arcsin",
        "arccos",
        "arctan",
        "arctan2",
        "arcsinh",
        "arccosh",
        "arctanh",
        "power",
        "float_power",
        "dot",
        "vdot",
        "inner",
        "matmul",
        "tensordot",
        "einsum",
        "linalg",
        "interp",
        "convolve",
        "correlate",
        "polyfit",
        "fft",
        "cov",
        "corrcoef",
        "sinc",
        "logaddexp",
    }
)
LIBRARIES = {"scipy", "piqp", "cvxpy", "clarabel", "cv2"}
# Libraries that a file may import: Clarabel (`mpc/solver.py` says why), and of SciPy the sparse
# matrices, which are only laid out.
MAY_IMPORT = {
    "mpc/solver.py": {"clarabel"},
    "mpc/paper_problem.py": {"clarabel", "scipy.sparse"},
    "mpc/force_problem.py": {"clarabel", "scipy.sparse"},
}
# Functions that may call anything, and why.
FREE = {
    "condensed_condition": "refuses settings; no number of it goes on",
    "optical": "`@` joins two Transforms",
    "_parts": "constants, of exact fractions",
}
DRAWS = {
    "random",
    "integers",
    "uniform",
    "spawn",
}  # of a generator: exact, as `normal` is not


def files():
    """Files of the control path and the plant by their names in slot_core."""
    found = [CORE / f"{name}.py" for name in GROUND]
    for room in ROOMS:
        found += (CORE / room).rglob("*.py")
    names = {path.relative_to(CORE).as_posix(): path for path in sorted(found)}
    assert set(OUTSIDE) <= set(names)
    return {name: path for name, path in names.items() if name not in OUTSIDE}


def is_kernel(node):
    """Whether a function is compiled."""
    names = {
        part.id
        for part in getattr(node, "decorator_list", ())
        if isinstance(part, ast.Name)
    }
    return bool(names & {"helper", "kernel", "unlocked_kernel"})


class Calls(ast.NodeVisitor):
    """Lines that may differ by processor."""

    def __init__(self, name):
        self.name, self.found, self.compiled = name, [], False

    def visit_FunctionDef(self, node):
        if node.name in FREE:
            return
        before, self.compiled = self.compiled, self.compiled or is_kernel(node)
        self.generic_visit(node)
        self.compiled = before

    def note(self, node, what):
        self.found.append(f"{self.name}:{node.lineno}: {what}")

    def visit_Attribute(self, node):
        if isinstance(node.value, ast.Name):
            if node.value.id == "math" and node.attr not in MATH:
                self.note(node, f"math.{node.attr}")
            if node.value.id == "np" and node.attr in NUMPY:
                self.note(node, f"np.{node.attr}")
            if node.value.id == "rng" and node.attr not in DRAWS:
                self.note(node, f"rng.{node.attr}")
        elif isinstance(node.value, ast.Attribute):
            if node.value.attr == "random" and node.attr not in {
                "Generator",
                "default_rng",
            }:
                self.note(node, f"np.random.{node.attr}")
            if node.value.attr in {"_rng", "_trouble"} and node.attr not in DRAWS:
                self.note(node, f"{node.value.attr}.{node.attr}")
        if node.attr == "dot" and not isinstance(node.value, ast.Name):
            self.note(node, ".dot")
        self.generic_visit(node)

    def visit_BinOp(self, node):
        self._operator(node)
        self.generic_visit(node)

    def visit_AugAssign(self, node):
        self._operator(node)
        self.generic_visit(node)

    def _operator(self, node):
        if isinstance(node.op, ast.MatMult):
            self.note(node, "@")
        if isinstance(node.op, ast.Pow):
            exponent = node.right if isinstance(node, ast.BinOp) else node.value
            exponent = exponent.value if isinstance(exponent, ast.Constant) else None
            if not (self.compiled and isinstance(exponent, int)) and not whole(node):
                self.note(node, "**")

    def visit_Call(self, node):
        if isinstance(node.func, ast.Name) and node.func.id in {"sum", "pow"}:
            self.note(node, f"{node.func.id}()")
        self.generic_visit(node)

    def visit_Import(self, node):
        self._imported(node, [alias.name for alias in node.names])

    def visit_ImportFrom(self, node):
        self._imported(node, [f"{node.module}.{alias.name}" for alias in node.names])

    def _imported(self, node, names):
        for name in names:
            if name.split(".")[0] in LIBRARIES and name not in MAY_IMPORT.get(
                self.name, ()
            ):
                self.note(node, f"import {name}")


def whole(node):
    """Whether a power is one of integers or of two, as 2**53 and (-1) ** n: exact everywhere."""
    base = node.left if isinstance(node, ast.BinOp) else node.target
    if isinstance(base, ast.UnaryOp):
        base = base.operand
    if isinstance(base, ast.Call):
        base = base.args[0]  # Fraction(2)
    return isinstance(base, ast.Constant) and base.value in {1, 2}


def test_control_path_and_plant_call_nothing_that_differs_by_processor():
    found = []
    for name, path in files().items():
        calls = Calls(name)
        calls.visit(ast.parse(path.read_text()))
        found += calls.found
    assert not found, "\n".join(found)


def test_compiled_kernels_call_nothing_of_the_c_library_that_differs_by_processor():
    for policy in POLICIES:
        for _ in ClosedLoop("flat", "walk", None, seed=0, policy=policy).run(3):
            pass
    objects = set(cached_objects())
    assert len(objects) >= 20
    found = {f"{path.name}: {symbol}" for path in objects for symbol in called(path)}
    assert not found


def cached_objects():
    """Cache files of the kernels that are loaded, each with an object file in it."""
    for module in pkgutil.walk_packages(slot_core.__path__, "slot_core."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, Dispatcher) and isinstance(value._cache, KernelCache):
                yield from (
                    value._cache.path(types, value.targetctx)
                    for types in value.signatures
                )


def called(path):
    """Functions in C_LIBRARY that an object file names in its table of symbols."""
    return {
        part.decode(errors="ignore") for part in path.read_bytes().split(b"\0")
    } & C_LIBRARY


UMATH = np._core._multiarray_umath


def numpy_features():
    """Features of this processor that NumPy can do without."""
    return " ".join(
        name for name in UMATH.__cpu_dispatch__ if UMATH.__cpu_features__[name]
    )


# Variables that let libraries choose other code, as they do on another processor.
LIBRARIES_OF_OTHERS = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": numpy_features(),
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2,-FMA4",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
}
PLAIN = {"NUMBA_CPU_NAME": "generic"}
PROCESSORS = {
    "BLAS, NumPy and C library of another, one thread": LIBRARIES_OF_OTHERS,
    "a BLAS with AVX2": {"OPENBLAS_CORETYPE": "Haswell"},
    "a plain x86-64 or aarch64": LIBRARIES_OF_OTHERS | PLAIN,
}
HERE = {
    key: os.environ[key] for key in os.environ if key not in LIBRARIES_OF_OTHERS | PLAIN
}
TICKS = 100


@functools.cache
def walked(name):
    """Lines of `same_bits.py` on a processor by its name, or on this one as it is."""
    program = Path(__file__).with_name("same_bits.py")
    return subprocess.run(
        [sys.executable, program, str(TICKS), *POLICIES],
        env=HERE | PROCESSORS.get(name, {}),
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()


SLOW = pytest.mark.slow, pytest.mark.timeout(900)  # compiles all kernels anew


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=SLOW if "plain" in n else ()) for n in PROCESSORS]
)
def test_every_processor_gives_the_same_walk_to_the_last_bit(name):
    here = walked("as it is")
    assert len(here) == len(POLICIES) * TICKS // 10
    assert walked(name) == here
