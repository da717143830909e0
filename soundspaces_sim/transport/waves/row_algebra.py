"""Algebra of rows of `LANES` numbers in kernels, as vector instructions.

A row holds one quantity of one cell (link, wall) for `LANES` sources that are simulated together. Lanes never
mix and nothing is fused, so a lane's bits do not depend on the others. LLVM's own vectorizer gives up on these
loops: it cannot know that rows do not overlap. Arrays are (n, LANES) float32, C-contiguous.
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
_VECTOR = ir.VectorType(ir.FloatType(), LANES)


def _data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return context.make_array(kind)(context, builder, value).data


def _row(builder: Any, data: Any, index: Any) -> Any:
    """Address of a row, as a vector."""
    lanes = ir.Constant(index.type, LANES)
    address = builder.gep(data, [builder.mul(index, lanes)])
    return builder.bitcast(address, _VECTOR.as_pointer())


def _load(builder: Any, address: Any) -> Any:
    return builder.load(address, align=4, typ=_VECTOR)


def _splat(builder: Any, value: Any) -> Any:
    zero = ir.Constant(ir.IntType(32), 0)
    vector = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, zero)
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(vector, ir.Constant(_VECTOR, ir.Undefined), mask)


def _factor(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return _splat(builder, context.cast(builder, value, kind, types.float32))


def _scaled(context: Any, builder: Any, sig: Any, args: Any) -> tuple[Any, Any]:
    """Of arguments (out, i, factor, rows, k): the address of out[i], and factor * rows[k]."""
    target = _row(builder, _data(context, builder, sig.args[0], args[0]), args[1])
    source = _row(builder, _data(context, builder, sig.args[3], args[3]), args[4])
    factor = _factor(context, builder, sig.args[2], args[2])
    return target, builder.fmul(factor, _load(builder, source))


@intrinsic
def add_scaled(typing_context: Any, out: Any, i: Any, factor: Any, rows: Any, k: Any) -> Any:
    """out[i] += factor * rows[k], all lanes."""
    signature = types.void(out, types.int64, factor, rows, types.int64)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        target, scaled = _scaled(context, builder, sig, args)
        builder.store(builder.fadd(_load(builder, target), scaled), target, align=4)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def set_scaled(typing_context: Any, out: Any, i: Any, factor: Any, rows: Any, k: Any) -> Any:
    """out[i] = factor * rows[k], all lanes."""
    signature = types.void(out, types.int64, factor, rows, types.int64)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        target, scaled = _scaled(context, builder, sig, args)
        builder.store(scaled, target, align=4)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def add_differences(
    typing_context: Any, out: Any, p: Any, i: Any, offset: Any, weight: Any, span: Any
) -> Any:
    """out[i] += sum of weight[k] * (p[i + offset[k]] - p[i]) over k from span[0] to span[1], all lanes.

    `offset`: (n,) int32; `weight`: (n,) float32.
    """
    signature = types.void(out, p, types.int64, offset, weight, types.UniTuple(types.int64, 2))

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        data = _data(context, builder, sig.args[1], args[1])
        offsets = _data(context, builder, sig.args[3], args[3])
        weights = _data(context, builder, sig.args[4], args[4])
        target = _row(builder, _data(context, builder, sig.args[0], args[0]), args[2])
        own = _load(builder, _row(builder, data, args[2]))
        total = cgutils.alloca_once(builder, _VECTOR)
        builder.store(_load(builder, target), total, align=4)
        first, last = (builder.extract_value(args[5], k) for k in (0, 1))
        with cgutils.for_range_slice(builder, first, last, ir.Constant(first.type, 1)) as (k, _):
            step = builder.sext(
                builder.load(builder.gep(offsets, [k]), typ=ir.IntType(32)), args[2].type
            )
            other = _load(builder, _row(builder, data, builder.add(args[2], step)))
            factor = _splat(builder, builder.load(builder.gep(weights, [k]), typ=ir.FloatType()))
            more = builder.fmul(factor, builder.fsub(other, own))
            builder.store(builder.fadd(builder.load(total, align=4, typ=_VECTOR), more), total, align=4)
        builder.store(builder.load(total, align=4, typ=_VECTOR), target, align=4)
        return context.get_dummy_value()

    return signature, codegen
