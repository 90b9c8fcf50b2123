"""Arguments of a kernel, unpacked once.

Numba unpacks the arrays of a tuple at every call, which takes longer for the arrays of
a robot than a time step. A `Handle` keeps the unpacked tuple in memory; passing it costs as much as an integer.
"""

# mypy: disable-error-code="no-untyped-def,misc,no-untyped-call"

import struct
import sys
from collections.abc import Iterator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import typeof
from numba.core import types
from numba.core.datamodel import models
from numba.core.registry import cpu_target
from numba.extending import (
    NativeValue,
    intrinsic,
    register_model,
    typeof_impl,
    unbox,
)


class _HandleType(types.Type):
    def __init__(self, content):
        self.content = content
        super().__init__(f"Handle({content})")


@register_model(_HandleType)
class _HandleModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, ir.IntType(8).as_pointer())


class Handle:
    """A tuple of arrays and numbers; the numbers are copied, the arrays are shared."""

    def __init__(self, content: tuple[Any, ...]) -> None:
        self._content = content  # keeps the arrays alive
        self._memory = np.array(list(_words(content)), dtype=np.uint64)
        self.numba_type = _HandleType(typeof(content))
        context = cpu_target.target_context
        if self._memory.nbytes != context.get_abi_sizeof(
            context.get_value_type(self.numba_type.content)
        ):
            raise TypeError(
                "Numba lays out the content of a Handle otherwise than _words does"
            )
        self.address: int = self._memory.ctypes.data

    def __reduce__(self) -> str:
        raise TypeError("a Handle holds a memory address and cannot be copied")


@typeof_impl.register(Handle)
def _typeof(handle, context):
    return handle.numba_type


@unbox(_HandleType)
def _unbox(kind, handle, c):
    address = c.pyapi.object_getattr_string(handle, "address")
    pointer = c.pyapi.long_as_voidptr(address)
    c.pyapi.decref(address)
    return NativeValue(pointer)


def _load(context, builder, handle, pointer):
    """The tuple at a pointer."""
    kind = context.get_value_type(handle.content).as_pointer()
    return builder.load(builder.bitcast(pointer, kind), align=1)


@intrinsic
def contents(typingctx, handle):
    """The tuple of a handle."""

    def build(context, builder, sig, args):
        return _load(context, builder, handle, args[0])

    return handle.content(handle), build


@intrinsic
def contents_at(typingctx, handle, address):
    """The tuple at the address of a handle of the same type as `handle`."""

    def build(context, builder, sig, args):
        pointer = builder.inttoptr(args[1], ir.IntType(8).as_pointer())
        return _load(context, builder, handle, pointer)

    return handle.content(handle, address), build


def _words(value: Any) -> Iterator[int]:
    """Words of 64 bits that Numba's form of a tuple, an array or a number takes.

    An array is the owner of its memory and its Python object (both none here), its number and size of items, its
    address, shape and strides. Raises TypeError for other values.
    """
    if isinstance(value, tuple):
        for item in value:
            yield from _words(item)
    elif isinstance(value, np.ndarray):
        yield from (0, 0, value.size, value.itemsize, value.ctypes.data)
        yield from (n % 2**64 for n in (*value.shape, *value.strides))
    elif isinstance(value, float):
        yield int.from_bytes(struct.pack("=d", value), sys.byteorder)
    elif isinstance(value, (int, np.int64)):
        # a bool takes a byte, and the next item begins with the next word
        yield int(value) % 2**64
    else:
        raise TypeError(
            f"a Handle holds tuples, arrays and numbers, not {type(value).__name__}"
        )
