"""Arguments of a kernel, unpacked once.

Numba unpacks the arrays of a tuple at every call, which takes longer than a time step for those of
a robot. A `Handle` keeps the unpacked tuple in memory; passing it costs as much as an integer.
"""

# mypy: disable-error-code="no-untyped-def,misc,no-untyped-call"

from __future__ import annotations

from typing import Any

import numpy as np
from llvmlite import ir
from numba import typeof
from numba.core import types
from numba.core.datamodel import models
from numba.extending import NativeValue, intrinsic, register_model, typeof_impl, unbox

from slot_core.compiled import kernel


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
        self._memory = np.zeros(_size(content), dtype=np.uint8)
        _write(content, self._memory)
        self.address: int = self._memory.ctypes.data
        self.numba_type = _HandleType(typeof(content))

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


@intrinsic
def contents(typingctx, handle):
    """The tuple of a handle."""

    def build(context, builder, sig, args):
        kind = context.get_value_type(handle.content).as_pointer()
        return builder.load(builder.bitcast(args[0], kind), align=1)

    return handle.content(handle), build


@intrinsic
def contents_at(typingctx, handle, address):
    """The tuple at the address of a handle of the same type as `handle`."""

    def build(context, builder, sig, args):
        kind = context.get_value_type(handle.content).as_pointer()
        return builder.load(builder.inttoptr(args[1], kind), align=1)

    return handle.content(handle, address), build


@intrinsic
def _put(typingctx, content, memory):
    def build(context, builder, sig, args):
        view = context.make_array(memory)(context, builder, args[1])
        builder.store(args[0], builder.bitcast(view.data, args[0].type.as_pointer()), align=1)
        return context.get_dummy_value()

    return types.void(content, memory), build


@intrinsic
def _size_of(typingctx, content):
    def build(context, builder, sig, args):
        return context.get_constant(types.intp, context.get_abi_sizeof(args[0].type))

    return types.intp(content), build


@kernel
def _size(content):
    """Bytes that a tuple takes."""
    return _size_of(content)


@kernel
def _write(content, memory):
    """Write a tuple into memory (bytes)."""
    _put(content, memory)
