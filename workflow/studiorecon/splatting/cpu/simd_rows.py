# SPDX-License-Identifier: Apache-2.0
"""Memory side of the sixteen lanes: loads and stores of flat arrays, transposed records, small integer tricks.

Nothing here checks bounds. Kernels index with sizes that the driver computed; a wrong index is a crash.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from studiorecon.splatting.conventions import LANES
from studiorecon.splatting.cpu.simd import FLAGS, FLOATS, INT32, INTS, Lanes, constant


def _address(context: Any, builder: Any, kind: Any, array: Any, index: Any, pointed: Any) -> Any:
    data = context.make_array(kind)(context, builder, value=array).data
    return builder.bitcast(builder.gep(data, [index]), pointed.as_pointer())


def _load(builder: Any, pointer: Any) -> Any:
    loaded = builder.load(pointer)
    loaded.align = 4
    return loaded


def _store(builder: Any, value: Any, pointer: Any) -> None:
    builder.store(value, pointer).align = 4


def _flat_floats(kind: Any) -> bool:
    return isinstance(kind, types.Array) and kind.ndim == 1 and kind.layout == "C" and kind.dtype == types.float32


@intrinsic
def load(typing: Any, array: Any, index: Any) -> Any:
    """array[index : index + 16] of a flat float32 array."""
    if not _flat_floats(array):
        return None
    emit = lambda context, builder, signature, v: _load(builder, _address(context, builder, array, v[0], v[1], FLOATS))  # noqa: E731
    return Lanes(array, types.intp), emit


@intrinsic
def store(typing: Any, array: Any, index: Any, lanes: Any) -> Any:
    """array[index : index + 16] = lanes."""
    if not _flat_floats(array):
        return None

    def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
        _store(builder, v[2], _address(context, builder, array, v[0], v[1], FLOATS))
        return context.get_dummy_value()

    return types.void(array, types.intp, Lanes), emit


@intrinsic
def item(typing: Any, array: Any, index: Any) -> Any:
    """array[index] without wrap-around of negative indices."""
    if not (isinstance(array, types.Array) and array.ndim == 1):
        return None
    emit = lambda context, builder, signature, v: builder.load(  # noqa: E731
        builder.gep(context.make_array(array)(context, builder, value=v[0]).data, [v[1]])
    )
    return array.dtype(array, types.intp), emit


@intrinsic
def prefetch(typing: Any, array: Any, index: Any) -> Any:
    """Prefetch the cache line of array[index]."""

    def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
        pointer = _address(context, builder, array, v[0], v[1], ir.IntType(8))
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, INT32, INT32, INT32])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0")
        builder.call(function, [pointer] + [ir.Constant(INT32, k) for k in (0, 3, 1)])
        return context.get_dummy_value()

    return types.void(array, types.intp), emit


@intrinsic
def take_ticket(typing: Any, counter: Any) -> Any:
    """counter[0], incremented afterwards; atomic, for handing tiles to threads."""

    def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
        pointer = context.make_array(counter)(context, builder, value=v[0]).data
        return builder.atomic_rmw("add", pointer, ir.Constant(ir.IntType(64), 1), "monotonic")

    return types.int64(counter), emit


@intrinsic
def lowest_bit(typing: Any, bits: Any) -> Any:
    """Index of the lowest set bit of a non-zero int64."""
    return types.int64(types.int64), lambda context, builder, signature, v: builder.cttz(
        v[0], ir.Constant(ir.IntType(1), 1)
    )


def _shuffle(builder: Any, a: Any, b: Any, lanes: list[int]) -> Any:
    return builder.shuffle_vector(a, b, ir.Constant(INTS, lanes))


def _transposed(builder: Any, rows: list[Any]) -> list[Any]:
    """Transpose of 16 vectors as a 16×16 matrix, in four stages of pairwise shuffles."""
    rows = list(rows)
    for d in (1, 2, 4, 8):
        low = [(j if (j // d) % 2 == 0 else LANES + j - d) for j in range(LANES)]
        high = [(j + d if (j // d) % 2 == 0 else LANES + j) for j in range(LANES)]
        turned: list[Any] = [None] * LANES
        for i in range(LANES):
            if (i // d) % 2 == 0:
                turned[i] = _shuffle(builder, rows[i], rows[i + d], low)
                turned[i + d] = _shuffle(builder, rows[i], rows[i + d], high)
        rows = turned
    return rows


@intrinsic
def store_records(
    typing: Any,
    array: Any,
    index: Any,
    v0: Any,
    v1: Any,
    v2: Any,
    v3: Any,
    v4: Any,
    v5: Any,
    v6: Any,
    v7: Any,
    v8: Any,
    v9: Any,
    v10: Any,
    v11: Any,
) -> Any:
    """Sixteen records of sixteen floats: array[index + 16·j + k] = lane j of the k-th vector; the last four are 0."""

    def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
        for j, record in enumerate(_transposed(builder, list(v[2:]) + [constant(0.0)] * 4)):
            place = builder.add(v[1], ir.Constant(v[1].type, LANES * j))
            _store(builder, record, _address(context, builder, array, v[0], place, FLOATS))
        return context.get_dummy_value()

    return types.void(array, types.intp, *([Lanes] * 12)), emit


@intrinsic
def take_moments(typing: Any, array: Any, index: Any) -> Any:
    """Ten vectors, the k-th with field k of sixteen records of sixteen floats; sets the records to zero."""
    ten = types.UniTuple(Lanes, 10)

    def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
        records = []
        for j in range(LANES):
            place = builder.add(v[1], ir.Constant(v[1].type, LANES * j))
            pointer = _address(context, builder, array, v[0], place, FLOATS)
            records.append(_load(builder, pointer))
            _store(builder, constant(0.0), pointer)
        return context.make_tuple(builder, ten, _transposed(builder, records)[:10])

    return ten(array, types.intp), emit


@intrinsic
def add_sums(
    typing: Any,
    array: Any,
    index: Any,
    v0: Any,
    v1: Any,
    v2: Any,
    v3: Any,
    v4: Any,
    v5: Any,
    v6: Any,
    v7: Any,
    v8: Any,
    v9: Any,
) -> Any:
    """array[index + k] += sum of the lanes of the k-th vector, by a transpose that adds, always in the same order."""

    def emit(context: Any, builder: Any, signature: Any, v: Any) -> Any:
        def halves(a: Any, b: Any, one: list[int], other: list[int]) -> Any:
            return builder.fadd(_shuffle(builder, a, b, one), _shuffle(builder, a, b, other), flags=FLAGS)

        def quads(*blocks: int) -> list[int]:
            return [4 * b + k for b in blocks for k in range(4)]

        x = list(v[2:]) + [constant(0.0)] * 6
        low = [m for b in range(4) for m in (4 * b, 16 + 4 * b, 4 * b + 1, 17 + 4 * b)]
        high = [m for b in range(4) for m in (4 * b + 2, 18 + 4 * b, 4 * b + 3, 19 + 4 * b)]
        eight = [halves(x[2 * k], x[2 * k + 1], low, high) for k in range(8)]
        low = [m for b in range(4) for m in (4 * b, 4 * b + 1, 16 + 4 * b, 17 + 4 * b)]
        high = [m for b in range(4) for m in (4 * b + 2, 4 * b + 3, 18 + 4 * b, 19 + 4 * b)]
        four = [halves(eight[2 * k], eight[2 * k + 1], low, high) for k in range(4)]
        even, odd = quads(0, 2, 4, 6), quads(1, 3, 5, 7)
        sums = halves(halves(four[0], four[1], even, odd), halves(four[2], four[3], even, odd), even, odd)
        pointer = _address(context, builder, array, v[0], v[1], FLOATS)
        _store(builder, builder.fadd(_load(builder, pointer), sums), pointer)
        return context.get_dummy_value()

    return types.void(array, types.intp, *([Lanes] * 10)), emit
