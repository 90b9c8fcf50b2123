"""SIMD vectors of four float64 for the kernels: of the legs FL FR RL RR, or of four plans.

`Lanes` is a type of the kernels: +, -, *, /, comparison, max, min and sqrt work lane by lane, and a
plain number stands for four equal ones. A kernel written for numbers therefore serves for one leg
or plan (numbers) and for four (Lanes); where the two differ it uses the functions below. LLVM
compiles Lanes to the vector registers of the processor: one of AVX, two of NEON.

Outside the kernels Lanes are the last axis (4,) of an array; `in_lanes` gives the kernels' view.
"""

# mypy: disable-error-code="no-untyped-def,misc,no-untyped-call"

import functools
import math
import operator

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.errors import RequireLiteralValue, TypingError
from numba.core.imputils import lower_builtin, lower_cast
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import (
    AbstractTemplate,
    infer_global,
    signature,
)
from numba.extending import intrinsic, overload, register_model
from numba.np.arrayobj import make_array, populate_array

from slot_core.compiled import OPTIONS
from slot_core.elementary import atan2, cos, sin

COUNT = 4
_NUMBERS = (types.Float, types.Integer)


class _Lanes(types.Type):
    """Four float64."""

    def can_convert_from(self, typingctx, other):
        return Conversion.safe if isinstance(other, _NUMBERS) else None


class _Mask(types.Type):
    """Four booleans."""

    def can_convert_from(self, typingctx, other):
        return Conversion.safe if isinstance(other, types.Boolean) else None


LANES = _Lanes("Lanes")
MASK = _Mask("Mask")
_VECTOR = ir.VectorType(ir.DoubleType(), COUNT)
_BITS = ir.VectorType(ir.IntType(1), COUNT)


@register_model(_Lanes)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _VECTOR)


@register_model(_Mask)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, dmm, fe_type):
        super().__init__(dmm, fe_type, _BITS)


def _spread(builder, value, vector):
    """The vector with this value in all lanes."""
    one = builder.insert_element(
        ir.Constant(vector, ir.Undefined), value, ir.IntType(32)(0)
    )
    mask = ir.Constant(ir.VectorType(ir.IntType(32), COUNT), [0] * COUNT)
    return builder.shuffle_vector(one, ir.Constant(vector, ir.Undefined), mask)


def _lane(builder, value, k):
    return builder.extract_element(value, ir.IntType(32)(k))


@lower_cast(types.Float, _Lanes)
@lower_cast(types.Integer, _Lanes)
def _number_to_lanes(context, builder, fromty, toty, value):
    return _spread(
        builder, context.cast(builder, value, fromty, types.float64), _VECTOR
    )


@lower_cast(types.Boolean, _Mask)
def _boolean_to_mask(context, builder, fromty, toty, value):
    return _spread(builder, builder.trunc(value, ir.IntType(1)), _BITS)


def _define(function, count, result, build, operand=LANES):
    """Overload `function` for `count` operands, or plain values: `build` emits a `result`."""
    plain = _NUMBERS if operand is LANES else types.Boolean

    class Template(AbstractTemplate):
        def generic(self, args, kws):
            own = [isinstance(arg, type(operand)) for arg in args]
            fits = len(args) == count and any(own) and not kws
            if fits and all(
                o or isinstance(a, plain) for o, a in zip(own, args)
            ):
                return signature(result, *[operand] * count)
            return None

    infer_global(function)(Template)

    @lower_builtin(function, *[type(operand)] * count)
    def lower(context, builder, sig, args):
        return build(builder, *args)


def _operator(name):
    return lambda builder, a, b: getattr(builder, name)(a, b)


def _comparison(sign):
    return lambda builder, a, b: builder.fcmp_ordered(sign, a, b)


def _chooser(sign):
    """max (>) and min (<) with Python's result: b where b is beyond a, else a."""
    return lambda builder, a, b: builder.select(
        builder.fcmp_ordered(sign, b, a), b, a
    )


def _sqrt(builder, a):
    kind = ir.FunctionType(_VECTOR, [_VECTOR])
    name = f"llvm.sqrt.v{COUNT}f64"
    return builder.call(
        cgutils.get_or_insert_function(builder.module, kind, name), [a]
    )


for _symbol, _name in (
    ("add", "fadd"),
    ("sub", "fsub"),
    ("mul", "fmul"),
    ("truediv", "fdiv"),
):
    _define(getattr(operator, _symbol), 2, LANES, _operator(_name))
    _define(getattr(operator, f"i{_symbol}"), 2, LANES, _operator(_name))
for _symbol, _name in (("lt", "<"), ("le", "<="), ("gt", ">"), ("ge", ">=")):
    _define(getattr(operator, _symbol), 2, MASK, _comparison(_name))
_define(operator.neg, 1, LANES, lambda builder, a: builder.fneg(a))
_define(math.sqrt, 1, LANES, _sqrt)
_define(operator.and_, 2, MASK, _operator("and_"), MASK)
_define(max, 2, LANES, _chooser(">"))
_define(min, 2, LANES, _chooser("<"))


@intrinsic
def where(typingctx, mask, a, b):
    """a where the mask is set, else b."""
    lanes = isinstance(mask, _Mask)
    kind = LANES if lanes else types.float64

    def build(context, builder, sig, args):
        test = args[0] if lanes else builder.trunc(args[0], ir.IntType(1))
        return builder.select(test, args[1], args[2])

    return kind(mask, kind, kind), build


def _reduced(value, kind, lanes, build):
    """Typing and code of a reduction: `build(builder, lanes)` of Lanes, a plain value as it is."""
    if not isinstance(value, type(lanes)):
        return kind(kind), lambda context, builder, sig, args: args[0]
    return kind(lanes), lambda context, builder, sig, args: build(
        builder, args[0]
    )


def _compared(sign, bits):
    """Comparison of the four bits of a mask with a number."""

    def build(builder, mask):
        found = builder.bitcast(mask, ir.IntType(COUNT))
        return builder.icmp_unsigned(sign, found, ir.IntType(COUNT)(bits))

    return build


@intrinsic
def any_lane(typingctx, mask):
    """Whether the mask is set for at least one leg."""
    return _reduced(mask, types.boolean, MASK, _compared("!=", 0))


@intrinsic
def all_lanes(typingctx, mask):
    """Whether the mask is set for all legs."""
    return _reduced(mask, types.boolean, MASK, _compared("==", -1))


@intrinsic
def total(typingctx, value):
    """Sum over the legs, (FL + FR) + (RL + RR)."""

    def build(builder, value):
        a, b, c, d = (_lane(builder, value, k) for k in range(COUNT))
        return builder.fadd(builder.fadd(a, b), builder.fadd(c, d))

    return _reduced(value, types.float64, LANES, build)


@intrinsic
def largest(typingctx, value):
    """Largest over the legs."""

    def build(builder, value):
        best, *others = (_lane(builder, value, k) for k in range(COUNT))
        for other in others:
            best = builder.select(
                builder.fcmp_ordered(">", other, best), other, best
            )
        return best

    return _reduced(value, types.float64, LANES, build)


@intrinsic(prefer_literal=True)
def lane(typingctx, value, number):
    """The value of one leg; `number` must be a constant."""
    k = (
        number.literal_value
        if isinstance(number, types.IntegerLiteral)
        else None
    )
    if k is None:
        raise RequireLiteralValue("the number of a lane must be a constant")
    return types.float64(
        LANES, number
    ), lambda context, builder, sig, args: _lane(builder, args[0], k)


@intrinsic
def join(typingctx, a, b, c, d):
    """Lanes of four numbers."""

    def build(context, builder, sig, args):
        out = ir.Constant(_VECTOR, ir.Undefined)
        for k, value in enumerate(args):
            out = builder.insert_element(out, value, ir.IntType(32)(k))
        return out

    return LANES(*[types.float64] * COUNT), build


@intrinsic
def like(typingctx, value, sample):
    """A number in the type of the sample: a number, or Lanes with this value in all lanes."""
    kind = LANES if isinstance(sample, _Lanes) else types.float64
    return kind(kind, sample), lambda context, builder, sig, args: args[0]


@intrinsic
def in_turn(typingctx, start, terms):
    """start + the terms, a tuple of Lanes; to a number the terms of one lane after those of another."""

    def build(context, builder, sig, args):
        parts = cgutils.unpack_tuple(builder, args[1])
        if not isinstance(start, _Lanes):
            parts = [_lane(builder, x, k) for k in range(COUNT) for x in parts]
        return functools.reduce(builder.fadd, parts, args[0])

    return start(start, terms), build


def _each_lane(function):
    """Overload a function of one number by its values lane by lane: slow, for rare use."""

    def each(x):
        return join(
            function(lane(x, 0)),
            function(lane(x, 1)),
            function(lane(x, 2)),
            function(lane(x, 3)),
        )

    @overload(function, jit_options=OPTIONS)
    def chosen(x):
        return each if isinstance(x, _Lanes) else None


_each_lane(cos)
_each_lane(sin)


@overload(atan2, jit_options=OPTIONS)  # type: ignore[arg-type]
def _atan2(y, x):
    if not (isinstance(y, _Lanes) and isinstance(x, _Lanes)):
        return None

    def each(y, x):
        return join(
            atan2(lane(y, 0), lane(x, 0)),
            atan2(lane(y, 1), lane(x, 1)),
            atan2(lane(y, 2), lane(x, 2)),
            atan2(lane(y, 3), lane(x, 3)),
        )

    return each


def _part(kind):
    """Type of the view `in_lanes` of a (nested, named) tuple of arrays (..., 4)."""
    if isinstance(kind, types.Array):
        if kind.layout == "F" or kind.dtype != types.float64:
            raise TypingError(
                f"{kind} has no lanes: they are float64, the last axis of an array"
            )
        # not aligned: NumPy aligns to 16 bytes, a vector needs 32
        return types.Array(LANES, kind.ndim - 1, kind.layout, aligned=False)
    return types.BaseTuple.from_types(
        [_part(part) for part in kind.types],
        getattr(kind, "instance_class", tuple),
    )


def _convert(context, builder, kind, out, value):
    """Views of the arrays without their last axis."""
    if not isinstance(kind, types.Array):
        parts = cgutils.unpack_tuple(builder, value, len(kind.types))
        triples = zip(kind.types, out.types, parts)
        parts = [_convert(context, builder, *triple) for triple in triples]
        return context.make_tuple(builder, out, parts)
    source, view = (
        make_array(kind)(context, builder, value),
        make_array(out)(context, builder),
    )
    shape, strides = (
        cgutils.unpack_tuple(builder, x)[:-1]
        for x in (source.shape, source.strides)
    )
    data = builder.bitcast(source.data, view.data.type)
    itemsize = context.get_abi_sizeof(context.get_data_type(out.dtype))
    populate_array(view, data, shape, strides, itemsize, None)
    return view._getvalue()


@intrinsic
def in_lanes(typingctx, arrays):
    """View of a (nested, named) tuple of arrays (..., 4): arrays (...) of Lanes.

    The four numbers of the last axis must be neighbours in memory. The view does not keep the
    memory alive: the caller of the kernel must.
    """
    out = _part(arrays)

    def build(context, builder, sig, args):
        return _convert(context, builder, arrays, out, args[0])

    return out(arrays), build
