"""Arrays that go to kernels, which trust shapes, types and values: checks and buffers."""

from collections import namedtuple
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Shapes = dict[str, tuple[int, ...]]  # by the names of arrays
Arrays = Any  # a named tuple of arrays, with the names of a `Shapes`


def checked(
    name: str,
    values: Any,
    shape: tuple[int, ...],
    finite: bool = True,
    error: type[ValueError] = ValueError,
) -> Array:
    """`values` as contiguous numbers of a shape, in which -1 stands for any length.

    Raises the error, which names what they are, for another shape, what is no number and, if they
    are to be `finite`, for NaN and infinity.
    """
    try:
        array = np.asarray(values, dtype=np.float64, order="C")
    except (TypeError, ValueError, OverflowError):
        raise error(f"{name}: expected numbers of shape {shape}") from None
    if array.shape != shape and (
        array.ndim != len(shape)
        or any(n not in (m, -1) for n, m in zip(shape, array.shape))
    ):
        raise error(f"{name}: shape {array.shape}, expected {shape}")
    # faster than `all`
    if finite and b"\0" in np.isfinite(array).tobytes():
        raise error(f"{name}: a value is not finite")
    return array


def named(name: str, fields: Iterable[str], module: str) -> Any:
    """Class of named tuples, a variable of its module: kernels on disk find it by both names."""
    return namedtuple(name, fields, module=module)


def zeros(shapes: Shapes, lanes: tuple[int, ...] = ()) -> dict[str, Array]:
    """Arrays of zeros by name; lanes = (4,): four side by side, on one axis more at the end."""
    return {name: np.zeros(shape + lanes) for name, shape in shapes.items()}


def one_buffer(shapes: Shapes) -> tuple[Array, dict[str, Array]]:
    """A buffer of zeros, and by name views of these shapes in it, one after the other."""
    ends = np.cumsum(
        [int(np.prod(shape, dtype=int)) for shape in shapes.values()]
    )
    buffer = np.zeros(ends[-1])
    return buffer, {
        name: part.reshape(shape)
        for (name, shape), part in zip(
            shapes.items(), np.split(buffer, ends[:-1])
        )
    }
