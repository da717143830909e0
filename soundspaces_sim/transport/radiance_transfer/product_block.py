"""Products of six rows with a panel of columns: sums stay in registers, where LLVM leaves them in memory.

A panel is columns side by side. A block is twelve vectors of sums, which fit with what they are made of on every
processor with sixteen registers. Every sum is over a panel's rows in order, so its bits do not depend on widths.

Source: K. Goto and R. A. van de Geijn (2008), Anatomy of high-performance matrix multiplication, ACM TOMS 34 (3).
"""

from __future__ import annotations

from typing import Any

import numba
from llvmlite import ir
from llvmlite.binding import get_host_cpu_features as host_features
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

ROWS = 6
#: numbers of a vector; of the shorter ones where Numba is told to compile for another processor
_LANES = 16 if host_features().get("avx512f") and not numba.config.CPU_NAME else 8  # type: ignore[attr-defined]
_VECTORS = range(2)
WIDTH = len(_VECTORS) * _LANES
_FLOAT, _VECTOR = ir.FloatType(), ir.VectorType(ir.FloatType(), _LANES)
_ANY, _ZERO = ir.Constant(_VECTOR, ir.Undefined), ir.Constant(_VECTOR, [0.0] * _LANES)


def _table(context: Any, builder: Any, kind: Any, value: Any) -> tuple[Any, Any]:
    """(Address, numbers from a row to the next) of a table whose rows are contiguous."""
    table = context.make_array(kind)(context, builder, value)
    step = cgutils.unpack_tuple(builder, table.strides)[0]
    return table.data, builder.sdiv(step, ir.Constant(step.type, 4))


def _vector(builder: Any, row: Any, number: int) -> Any:
    address = builder.gep(row, [ir.Constant(ir.IntType(64), number * _LANES)])
    return builder.bitcast(address, _VECTOR.as_pointer())


def _of_all(builder: Any, number: Any) -> Any:
    """A vector of one number."""
    mask = ir.Constant(ir.VectorType(ir.IntType(32), _LANES), [0] * _LANES)
    first = builder.insert_element(_ANY, number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(first, _ANY, mask)


@intrinsic
def set_block(
    typing_context: Any, out: Any, left: Any, rows: Any, first: Any, panel: Any, length: Any
) -> Any:
    """out[n] = sum over c of left[rows[n], first + c] * panel[c]: `out` (ROWS, WIDTH), `rows` (ROWS,), `panel`
    (length, WIDTH); float32 whose rows are contiguous."""
    if any(kind.dtype != types.float32 for kind in (out, left, panel)):
        raise TypingError("set_block takes tables of float32")
    signature = types.void(out, left, rows, first, panel, length)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        (into, of_out), (own, of_left), (right, of_panel) = (
            _table(context, builder, sig.args[n], args[n]) for n in (0, 1, 4)
        )
        lefts = [
            builder.gep(own, [builder.add(builder.mul(row, of_left), args[3])])
            for row in cgutils.unpack_tuple(builder, args[2])
        ]
        sums = [[cgutils.alloca_once_value(builder, _ZERO) for _ in _VECTORS] for _ in lefts]
        with cgutils.for_range(builder, args[5]) as loop:
            row = builder.gep(right, [builder.mul(loop.index, of_panel)])
            columns = [builder.load(_vector(builder, row, v), align=4, typ=_VECTOR) for v in _VECTORS]
            for address, of_row in zip(lefts, sums):
                number = builder.load(builder.gep(address, [loop.index]), align=4, typ=_FLOAT)
                factor = _of_all(builder, number)
                for total, column in zip(of_row, columns):
                    product = builder.fmul(factor, column, flags=("contract",))
                    before = builder.load(total, typ=_VECTOR)
                    builder.store(builder.fadd(before, product, flags=("contract",)), total)
        for n, of_row in enumerate(sums):
            row = builder.gep(into, [builder.mul(ir.Constant(of_out.type, n), of_out)])
            for v, total in enumerate(of_row):
                builder.store(builder.load(total, typ=_VECTOR), _vector(builder, row, v), align=4)
        return context.get_dummy_value()

    return signature, codegen
