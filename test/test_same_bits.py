"""Same bits everywhere: the control path and the plant call nothing that differs by processor.

usage: test_same_bits.py prints digests of state, preview, plan and command of walks.
"""

import ast
import dataclasses
import functools
import hashlib
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

SOURCES = Path(__file__).resolve().parents[1] / "src"
CORE = SOURCES / "slot_core" / "slot_core"
PAPER = SOURCES / "slot_paper" / "slot_paper"
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
OF_THE_PAPER = ("problem", "gaits", "force_map")  # its policies
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
    "frexp",
    "ldexp",
    "prod",
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
# Libraries that a file may import: Clarabel (`mpc/force_problem.py` says why), and of SciPy the sparse
# matrices, which are only laid out.
MAY_IMPORT = {
    "slot_paper/problem.py": {"clarabel", "scipy.sparse"},
    "mpc/force_problem.py": {"clarabel", "scipy.sparse"},
}
# Functions that may call anything, and why.
FREE = {
    "condensed_condition": "refuses settings; no number of it goes on",
    "optical": "`@` joins two Transforms",
    "arc_length": "of points along a leg, at the desk",
    "at_shares": "of points along a leg, at the desk",
    "_parts": "constants, of exact fractions",
}
# of a generator: exact, as `normal` is not
DRAWS = {"random", "integers", "uniform", "spawn"}


def files():
    """Files of the control path and the plant by their names in slot_core, or in slot_paper."""
    found = [CORE / f"{name}.py" for name in GROUND]
    for room in ROOMS:
        found += (CORE / room).rglob("*.py")
    names = {path.relative_to(CORE).as_posix(): path for path in sorted(found)}
    names |= {
        f"slot_paper/{name}.py": PAPER / f"{name}.py" for name in OF_THE_PAPER
    }
    assert set(OUTSIDE) <= set(names)
    return {name: path for name, path in names.items() if name not in OUTSIDE}


def is_kernel(node):
    """Whether a function is compiled."""
    names = (d.id for d in node.decorator_list if isinstance(d, ast.Name))
    return not {"helper", "kernel", "unlocked_kernel"}.isdisjoint(names)


def differs(node, file, compiled):
    """Whether a node's code may differ by processor."""
    found = False
    match node:
        case ast.Attribute(value=ast.Name(id="math"), attr=name):
            found = name not in MATH
        case ast.Attribute(value=ast.Name(id="np"), attr=name):
            found = name in NUMPY
        case ast.Attribute(value=ast.Attribute(attr="random"), attr=name):
            found = name not in {"Generator", "default_rng"}
        case ast.Attribute(
            value=ast.Name(id="rng") | ast.Attribute(attr="_rng" | "_trouble"),
            attr=name,
        ):
            found = name not in DRAWS
        case (
            ast.Attribute(attr="dot")
            | ast.BinOp(op=ast.MatMult())
            | ast.AugAssign(op=ast.MatMult())
            | ast.Call(func=ast.Name(id="sum" | "pow"))
        ):
            found = True
        case (
            ast.BinOp(op=ast.Pow(), left=base, right=exponent)
            | ast.AugAssign(op=ast.Pow(), target=base, value=exponent)
        ):
            found = not exact(base, exponent, compiled)
        case ast.Import(names=names) | ast.ImportFrom(names=names):
            start = (
                f"{node.module}." if isinstance(node, ast.ImportFrom) else ""
            )
            imported = {f"{start}{alias.name}" for alias in names}
            others = imported - MAY_IMPORT.get(file, set())
            found = any(name.split(".")[0] in LIBRARIES for name in others)
    return found


def exact(base, exponent, compiled):
    """Whether a power is the same everywhere: of a kernel, by an integer; or of one or two."""
    match base:
        case ast.Constant(value=1 | 2):
            return True
        # Fraction(2)
        case ast.UnaryOp(operand=inner) | ast.Call(args=[inner, *_]):
            return exact(inner, exponent, compiled)
    return compiled and isinstance(getattr(exponent, "value", None), int)


def test_control_path_and_plant_call_nothing_that_differs_by_processor():
    found = []
    for name, path in files().items():
        tree, free, compiled = ast.parse(path.read_text()), set(), set()
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and node.name in FREE:
                free |= {*ast.walk(node)}
            if isinstance(node, ast.FunctionDef) and is_kernel(node):
                compiled |= {*ast.walk(node)}
        for node in {*ast.walk(tree)} - free:
            if differs(node, name, node in compiled):
                found.append(f"{name}:{node.lineno}: {ast.unparse(node)}")
    assert not found, "\n".join(found)


def test_compiled_kernels_call_nothing_of_the_c_library_that_differs_by_processor():
    for policy in POLICIES:
        for _ in ClosedLoop("flat", "walk", None, seed=0, policy=policy).run(3):
            pass
    objects = set(cached_objects())
    assert len(objects) >= 20
    found = set()
    for path in objects:  # functions that its table of symbols names
        symbols = {
            part.decode(errors="ignore")
            for part in path.read_bytes().split(b"\0")
        }
        found |= {f"{path.name}: {symbol}" for symbol in symbols & C_LIBRARY}
    assert not found


def cached_objects():
    """Cache files of the kernels that are loaded, each with an object file in it."""
    for module in pkgutil.walk_packages(slot_core.__path__, "slot_core."):
        for value in vars(importlib.import_module(module.name)).values():
            if isinstance(value, Dispatcher) and isinstance(
                value._cache, KernelCache
            ):
                yield from (
                    value._cache.path(types, value.targetctx)
                    for types in value.signatures
                )


UMATH = np._core._multiarray_umath
# Features of this processor that NumPy can do without.
FEATURES = [n for n in UMATH.__cpu_dispatch__ if UMATH.__cpu_features__[n]]
# Variables that let libraries choose other code, as they do on another processor.
LIBRARIES_OF_OTHERS = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": " ".join(FEATURES),
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
    key: os.environ[key]
    for key in os.environ
    if key not in LIBRARIES_OF_OTHERS | PLAIN
}
TICKS = 60


# m/s, m/s, rad/s: forward, sideways, turning
VELOCITY = np.array([0.03, 0.01, 0.05])


def content(value):
    """Bytes of a number, text or array, or of all those in a dataclass."""
    if dataclasses.is_dataclass(value):
        fields = (
            getattr(value, field.name) for field in dataclasses.fields(value)
        )
        return b"".join(content(part) for part in fields)
    if isinstance(value, np.ndarray):
        return value.tobytes()
    return repr(value).encode()


def print_digests():
    """Walk with each policy and print, after every tenth tick, the digest of each stage up to there."""
    for policy in POLICIES:
        stages = {
            name: hashlib.sha256()
            for name in ("estimate", "preview", "plan", "command")
        }
        loop = ClosedLoop("flat", "walk", VELOCITY, seed=3, policy=policy)
        for k, tick in enumerate(loop.run(TICKS)):
            for name, digest in stages.items():
                digest.update(content(getattr(tick, name)))
            if k % 10 == 9:
                print(
                    policy,
                    k + 1,
                    *(f"{n} {d.hexdigest()[:16]}" for n, d in stages.items()),
                )


@functools.cache
def walked(name):
    """Lines of `print_digests` on a processor by its name, or on this one as it is."""
    return subprocess.run(
        [sys.executable, __file__],
        env=HERE | PROCESSORS.get(name, {}),
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(
            name,  # a plain processor compiles all kernels anew
            marks=(pytest.mark.slow, pytest.mark.timeout(900))
            if "plain" in name
            else (),
        )
        for name in PROCESSORS
    ],
)
def test_every_processor_gives_the_same_walk_to_the_last_bit(name):
    here = walked("as it is")
    assert len(here) == len(POLICIES) * TICKS // 10
    assert walked(name) == here


if __name__ == "__main__":
    print_digests()
