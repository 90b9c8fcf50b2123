"""Arrays that go to kernels, which trust shapes, types and values: checks and buffers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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
    if array.ndim != len(shape) or any(
        n not in (m, -1) for n, m in zip(shape, array.shape)
    ):
        raise error(f"{name}: shape {array.shape}, expected {shape}")
    if finite and not np.isfinite(array).all():
        raise error(f"{name}: a value is not finite")
    return array


def one_buffer(
    shapes: dict[str, tuple[int, ...]],
) -> tuple[Array, dict[str, Array]]:
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
