"""Algebra of rows of `LANES` numbers in kernels, as vector instructions.

A row holds one quantity of one cell (link, wall) for `LANES` sources that are simulated together. Lanes never
mix and nothing is fused, so a lane's bits do not depend on the others. LLVM's own vectorizer gives up on these
loops: it cannot know that rows do not overlap. Arrays are (n, LANES) float32, if not said otherwise, C-contiguous.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

LANES = 8
FOUR = 4  # rows of `add_differences_of_four`
_VECTOR = ir.VectorType(ir.FloatType(), LANES)
_DOUBLES = ir.VectorType(ir.DoubleType(), LANES)


def _data(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    return context.make_array(kind)(context, builder, value).data


def _row(builder: Any, data: Any, index: Any, kind: ir.VectorType = _VECTOR) -> Any:
    """Address of a row, as a vector."""
    lanes = ir.Constant(index.type, LANES)
    address = builder.gep(data, [builder.mul(index, lanes)])
    return builder.bitcast(address, kind.as_pointer())


def _load(builder: Any, address: Any) -> Any:
    return builder.load(address, align=4, typ=_VECTOR)


def _splat(builder: Any, value: Any, kind: ir.VectorType = _VECTOR) -> Any:
    zero = ir.Constant(ir.IntType(32), 0)
    vector = builder.insert_element(ir.Constant(kind, ir.Undefined), value, zero)
    mask = ir.Constant(ir.VectorType(ir.IntType(32), LANES), [0] * LANES)
    return builder.shuffle_vector(vector, ir.Constant(kind, ir.Undefined), mask)


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
def add_in_double(typing_context: Any, out: Any, i: Any, factor: Any, rows: Any, k: Any) -> Any:
    """out[i] += factor * rows[k], all lanes; `out` is (n, LANES) float64."""
    signature = types.void(out, types.int64, types.float64, rows, types.int64)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        target = _row(builder, _data(context, builder, sig.args[0], args[0]), args[1], _DOUBLES)
        source = _row(builder, _data(context, builder, sig.args[3], args[3]), args[4])
        more = builder.fmul(
            _splat(builder, args[2], _DOUBLES), builder.fpext(_load(builder, source), _DOUBLES)
        )
        total = builder.load(target, align=8, typ=_DOUBLES)
        builder.store(builder.fadd(total, more), target, align=8)
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


def _differences(rows: int, context: Any, builder: Any, sig: Any, args: Any) -> Any:
    """`add_differences` with i + r in place of i, for r below `rows`: sums of several rows hide each other's
    latency."""
    kind = args[2].type
    data = _data(context, builder, sig.args[1], args[1])
    offsets = _data(context, builder, sig.args[3], args[3])
    weights = _data(context, builder, sig.args[4], args[4])
    out = _data(context, builder, sig.args[0], args[0])
    numbers = [builder.add(args[2], ir.Constant(kind, r)) for r in range(rows)]
    targets = [_row(builder, out, i) for i in numbers]
    own = [_load(builder, _row(builder, data, i)) for i in numbers]
    totals = [cgutils.alloca_once(builder, _VECTOR) for _ in numbers]
    for total, target in zip(totals, targets, strict=True):
        builder.store(_load(builder, target), total, align=4)
    first, last = (builder.extract_value(args[5], k) for k in (0, 1))
    with cgutils.for_range_slice(builder, first, last, ir.Constant(first.type, 1)) as (k, _):
        step = builder.sext(builder.load(builder.gep(offsets, [k]), typ=ir.IntType(32)), kind)
        factor = _splat(builder, builder.load(builder.gep(weights, [k]), typ=ir.FloatType()))
        for i, mine, total in zip(numbers, own, totals, strict=True):
            other = _load(builder, _row(builder, data, builder.add(i, step)))
            more = builder.fmul(factor, builder.fsub(other, mine))
            builder.store(builder.fadd(builder.load(total, align=4, typ=_VECTOR), more), total, align=4)
    for total, target in zip(totals, targets, strict=True):
        builder.store(builder.load(total, align=4, typ=_VECTOR), target, align=4)
    return context.get_dummy_value()


@intrinsic
def add_differences(
    typing_context: Any, out: Any, p: Any, i: Any, offset: Any, weight: Any, span: Any
) -> Any:
    """out[i] += sum of weight[k] * (p[i + offset[k]] - p[i]) over k from span[0] to span[1], all lanes.

    `offset`: (n,) int32; `weight`: (n,) float32.
    """
    signature = types.void(out, p, types.int64, offset, weight, types.UniTuple(types.int64, 2))
    return signature, partial(_differences, 1)


@intrinsic
def add_differences_of_four(
    typing_context: Any, out: Any, p: Any, i: Any, offset: Any, weight: Any, span: Any
) -> Any:
    """`add_differences` of i to i + 3, to the same bits."""
    signature = types.void(out, p, types.int64, offset, weight, types.UniTuple(types.int64, 2))
    return signature, partial(_differences, FOUR)


def _line(builder: Any, terms: list[tuple[Any, Any]], total: Any) -> Any:
    """total + factor * row + …, one after the other."""
    for factor, row in terms:
        more = builder.fmul(factor, row)
        total = more if total is None else builder.fadd(total, more)
    return total


@intrinsic
def push_branch(
    typing_context: Any, e: Any, p: Any, i: Any, branch: Any, k: Any, share: Any, pull: Any
) -> Any:
    """e[i] += share * u[k] + pull * (b[k] - a[k] - p[i]), all lanes; `branch`: (u, a, b)."""
    signature = types.void(e, p, types.int64, branch, types.int64, share, pull)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        target = _row(builder, _data(context, builder, sig.args[0], args[0]), args[2])
        own = _load(builder, _row(builder, _data(context, builder, sig.args[1], args[1]), args[2]))
        u, a, b = (_load(builder, x) for x in _branch(context, builder, sig.args[3], args[3], args[4]))
        share, pull = (_factor(context, builder, sig.args[n], args[n]) for n in (5, 6))
        less = _splat(builder, builder.fneg(context.cast(builder, args[6], sig.args[6], types.float32)))
        terms = [(less, own), (less, a), (pull, b), (share, u)]
        builder.store(_line(builder, terms, _load(builder, target)), target, align=4)
        return context.get_dummy_value()

    return signature, codegen


@intrinsic
def move_branch(
    typing_context: Any, branch: Any, k: Any, e: Any, p: Any, i: Any, gain: Any, forces: Any
) -> Any:
    """u[k] = gain * (p[i] + e[i] / 2 + a[k] - b[k]), then a[k] = mass * u[k] - a[k], b[k] += stiffness * u[k], all
    lanes; `branch`: (u, a, b), `forces`: (mass, stiffness)."""
    signature = types.void(branch, types.int64, e, p, types.int64, gain, forces)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        change, own = (
            _load(builder, _row(builder, _data(context, builder, sig.args[n], args[n]), args[4]))
            for n in (2, 3)
        )
        u, a, b = _branch(context, builder, sig.args[0], args[0], args[1])
        force, spring = _load(builder, a), _load(builder, b)
        gain = context.cast(builder, args[5], sig.args[5], types.float32)
        full, less = _splat(builder, gain), _splat(builder, builder.fneg(gain))
        half = _splat(builder, builder.fmul(ir.Constant(ir.FloatType(), 0.5), gain))
        terms = [(full, own), (half, change), (full, force), (less, spring)]
        moved = _line(builder, terms, None)
        mass, stiffness = (
            _factor(context, builder, sig.args[6].types[n], builder.extract_value(args[6], n))
            for n in (0, 1)
        )
        builder.store(moved, u, align=4)
        builder.store(builder.fadd(builder.fneg(force), builder.fmul(mass, moved)), a, align=4)
        builder.store(builder.fadd(spring, builder.fmul(stiffness, moved)), b, align=4)
        return context.get_dummy_value()

    return signature, codegen


def _branch(context: Any, builder: Any, kind: Any, value: Any, k: Any) -> list[Any]:
    """Addresses of a branch's rows."""
    return [
        _row(builder, _data(context, builder, kind.types[n], builder.extract_value(value, n)), k)
        for n in range(3)
    ]
