# SPDX-License-Identifier: Apache-2.0
"""Sixteen-lane float32 values inside numba kernels, compiled by the LLVM that numba ships.

numba's own vectoriser gives up on masked, branchy loops over pixels, so this module adds two numba types, ``Lanes`` (16
floats) and ``Mask`` (16 bits), and intrinsics that emit LLVM vector instructions. LLVM lowers them to the machine's
own: AVX-512, two AVX2 halves, four NEON or SSE quarters. ``madd`` and its relatives are fused where the target fuses,
otherwise a product and a sum.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.datamodel import models
from numba.extending import intrinsic, overload, register_model

from studiorecon.splatting.conventions import LANES

FLOATS = ir.VectorType(ir.FloatType(), LANES)
INTS = ir.VectorType(ir.IntType(32), LANES)
BITS = ir.VectorType(ir.IntType(1), LANES)
INT32 = ir.IntType(32)
FLAGS = ("nsz", "contract")


class _LanesType(types.Type):
    def __init__(self) -> None:
        super().__init__("Lanes")


class _MaskType(types.Type):
    def __init__(self) -> None:
        super().__init__("Mask")


Lanes, Mask = _LanesType(), _MaskType()


@register_model(_LanesType)
class _LanesModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, FLOATS)


@register_model(_MaskType)
class _MaskModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, BITS)


def constant(value: float) -> ir.Constant:
    """The IR constant with ``value`` in every lane."""
    return ir.Constant(FLOATS, [float(value)] * LANES)


def call(builder: Any, name: str, returned: Any, arguments: list[Any]) -> Any:
    """A call of the LLVM intrinsic ``name``."""
    kind = ir.FunctionType(returned, [a.type for a in arguments])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), arguments)


def emit_madd(builder: Any, a: Any, b: Any, c: Any) -> Any:
    """a·b + c by fmuladd: where the instruction is missing, fma is sixteen calls of a C function (70 ms instead of
    4)."""
    return call(builder, "llvm.fmuladd.v16f32", FLOATS, [a, b, c])


def _arithmetic(op: str) -> Any:
    @intrinsic
    def binary(typing: Any, a: Any, b: Any) -> Any:
        if a == Lanes and b == Lanes:
            return Lanes(Lanes, Lanes), lambda context, builder, signature, v: getattr(builder, op)(
                v[0], v[1], flags=FLAGS
            )
        return None

    return binary


_add, _subtract, _multiply, _divide = _arithmetic("fadd"), _arithmetic("fsub"), _arithmetic("fmul"), _arithmetic("fdiv")


def _register(symbol: Any, function: Any) -> None:
    number = (types.Float, types.Integer)

    # numba compares the parameters of an overload with those of the lambda that it returns, annotations included: hence
    # none.
    @overload(symbol)
    def binary(a, b):
        if a == Lanes and b == Lanes:
            return lambda a, b: function(a, b)
        if a == Lanes and isinstance(b, number):
            return lambda a, b: function(a, broadcast(np.float32(b)))
        if b == Lanes and isinstance(a, number):
            return lambda a, b: function(broadcast(np.float32(a)), b)
        return None


@overload(operator.neg)
def _negative(a):
    return (lambda a: zeros() - a) if a == Lanes else None


@intrinsic
def broadcast(typing: Any, x: Any) -> Any:
    """The float32 ``x`` in every lane."""

    def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
        nothing = ir.Constant(FLOATS, ir.Undefined)
        first = builder.insert_element(nothing, v[0], ir.Constant(INT32, 0))
        return builder.shuffle_vector(first, nothing, ir.Constant(INTS, [0] * LANES))

    return (Lanes(types.float32), emit) if x == types.float32 else None


for _symbol, _function in (
    (operator.add, _add),
    (operator.sub, _subtract),
    (operator.mul, _multiply),
    (operator.truediv, _divide),
):
    _register(_symbol, _function)


@intrinsic
def zeros(typing: Any) -> Any:
    """Zero in every lane."""
    return Lanes(), lambda context, builder, signature, v: constant(0.0)


@intrinsic
def madd(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a·b + c"""
    return Lanes(Lanes, Lanes, Lanes), lambda context, builder, signature, v: emit_madd(builder, v[0], v[1], v[2])


@intrinsic
def nmadd(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """c − a·b"""
    return Lanes(Lanes, Lanes, Lanes), lambda context, builder, signature, v: emit_madd(
        builder, builder.fneg(v[0]), v[1], v[2]
    )


@intrinsic
def msub(typing: Any, a: Any, b: Any, c: Any) -> Any:
    """a·b − c"""
    return Lanes(Lanes, Lanes, Lanes), lambda context, builder, signature, v: emit_madd(
        builder, v[0], v[1], builder.fneg(v[2])
    )


@intrinsic
def root(typing: Any, a: Any) -> Any:
    """√a"""
    return Lanes(Lanes), lambda context, builder, signature, v: call(builder, "llvm.sqrt.v16f32", FLOATS, [v[0]])


@intrinsic
def magnitude(typing: Any, a: Any) -> Any:
    """|a|"""
    return Lanes(Lanes), lambda context, builder, signature, v: call(builder, "llvm.fabs.v16f32", FLOATS, [v[0]])


def _comparison(op: str) -> Any:
    @intrinsic
    def compare(typing: Any, a: Any, b: Any) -> Any:
        return Mask(Lanes, Lanes), lambda context, builder, signature, v: builder.fcmp_ordered(op, v[0], v[1])

    return compare


# Ordered comparisons: false wherever a NaN takes part.
at_least, above, below = _comparison(">="), _comparison(">"), _comparison("<")


@intrinsic
def both(typing: Any, a: Any, b: Any) -> Any:
    """Lanes set in both masks."""
    return Mask(Mask, Mask), lambda context, builder, signature, v: builder.and_(v[0], v[1])


@intrinsic
def mask_from_bits(typing: Any, bits: Any) -> Any:
    """The mask whose lane i is bit i of an int64."""
    return Mask(types.int64), lambda context, builder, signature, v: builder.bitcast(
        builder.trunc(v[0], ir.IntType(LANES)), BITS
    )


@intrinsic
def bits_from_mask(typing: Any, mask: Any) -> Any:
    """The int64 whose bit i is lane i of a mask."""
    wide = ir.IntType(64)
    return types.int64(Mask), lambda context, builder, signature, v: builder.zext(
        builder.bitcast(v[0], ir.IntType(LANES)), wide
    )


@intrinsic
def select(typing: Any, mask: Any, a: Any, b: Any) -> Any:
    """``a`` where the mask is set, else ``b``."""
    return Lanes(Mask, Lanes, Lanes), lambda context, builder, signature, v: builder.select(v[0], v[1], v[2])


@intrinsic
def where(typing: Any, mask: Any, a: Any) -> Any:
    """``a`` where the mask is set, else 0, also where ``a`` is NaN."""
    return Lanes(Mask, Lanes), lambda context, builder, signature, v: builder.select(v[0], v[1], constant(0.0))


def _choice(op: str) -> Any:
    @intrinsic
    def choose(typing: Any, a: Any, b: Any) -> Any:
        def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
            return builder.select(builder.fcmp_ordered(op, v[0], v[1], flags=FLAGS), v[0], v[1])

        return Lanes(Lanes, Lanes), emit

    return choose


# For a NaN and a number these return the second argument, so put the limit second.
least, most = _choice("<"), _choice(">")


@intrinsic
def exp2(typing: Any, a: Any) -> Any:
    """2^a for a in [−126, 126], relative error 2e-7; outside, the result is arbitrary and must be masked."""

    def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
        # Adding 1.5·2²³ rounds to an integer in the low mantissa bits: no rounding instruction, same on every target.
        shifted = builder.fadd(v[0], constant(12582912.0))
        fraction = builder.fsub(v[0], builder.fsub(shifted, constant(12582912.0)))
        power = constant(1.3333558e-3)
        for coefficient in (9.6181291e-3, 5.5504109e-2, 2.4022651e-1, 6.9314718e-1, 1.0):
            power = emit_madd(builder, power, fraction, constant(coefficient))
        exponent = builder.shl(builder.bitcast(shifted, INTS), ir.Constant(INTS, [23] * LANES))
        return builder.bitcast(builder.add(builder.bitcast(power, INTS), exponent), FLOATS)

    return Lanes(Lanes), emit


@intrinsic
def log2(typing: Any, a: Any) -> Any:
    """log2 of positive normal floats, error 2e-7 near 1."""

    def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
        def ints(value: int) -> Any:
            return ir.Constant(INTS, [value] * LANES)

        bits = builder.bitcast(v[0], INTS)
        exponent = builder.ashr(builder.sub(bits, ints(0x3F400000)), ints(23))  # leaves a mantissa in [0.75, 1.5)
        mantissa = builder.bitcast(builder.sub(bits, builder.shl(exponent, ints(23))), FLOATS)
        ratio = builder.fdiv(builder.fsub(mantissa, constant(1)), builder.fadd(mantissa, constant(1)))
        square = builder.fmul(ratio, ratio)
        series = constant(0.320598898)
        for coefficient in (0.412198583, 0.577078016, 0.961796694, 2.885390082):
            series = emit_madd(builder, series, square, constant(coefficient))
        return emit_madd(builder, ratio, series, builder.sitofp(exponent, FLOATS))

    return Lanes(Lanes), emit
