"""Products of six rows with a panel of columns: sums stay in registers, where LLVM leaves them in memory.

A panel is columns side by side. Of a block, two vectors of each row are summed at a time: twelve sums, which fit
with what they are made of into sixteen registers. Every sum is over a panel's rows in order, so its bits do not
depend on how wide vectors are.

Source: K. Goto and R. A. van de Geijn (2008), Anatomy of high-performance matrix multiplication, ACM TOMS 34 (3).
"""

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.errors import TypingError
from numba.extending import intrinsic

ROWS = 6
WIDTH = 32  # on any processor, as arrays have it; the cache of kernels tells processors apart, not their arrays
_TOGETHER = 2  # vectors
_FLOAT = ir.FloatType()


def _lanes(context: Any) -> int:
    """Numbers of a vector of the processor that is compiled for."""
    return 16 if "+avx512f" in context.codegen().magic_tuple()[2].split(",") else 8


def _table(context: Any, builder: Any, kind: Any, value: Any) -> tuple[Any, Any, Any]:
    """(Address of a table, numbers from a row to the next, and from a column to the next)."""
    table = context.make_array(kind)(context, builder, value)
    row, column = cgutils.unpack_tuple(builder, table.strides)
    size = ir.Constant(row.type, 4)
    return table.data, builder.sdiv(row, size), builder.sdiv(column, size)


def _of_all(builder: Any, number: Any, lanes: int) -> Any:
    """A vector of one number."""
    nothing = ir.Constant(ir.VectorType(_FLOAT, lanes), ir.Undefined)
    first = builder.insert_element(nothing, number, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    return builder.shuffle_vector(first, nothing, mask)


@intrinsic
def set_block(
    typing_context: Any, out: Any, left: Any, rows: Any, first: Any, panel: Any, length: Any
) -> Any:
    """out[n] = sum over c of left[rows[n], first + c] * panel[c]: `out` (ROWS, WIDTH), `rows` (ROWS,), `panel`
    (length, WIDTH); float32, the rows of `out` and of `panel` contiguous."""
    if any(kind.dtype != types.float32 or kind.ndim != 2 for kind in (out, left, panel)):
        raise TypingError("set_block takes tables of float32")
    signature = types.void(out, left, rows, first, panel, length)

    def codegen(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        into, of_out, _ = _table(context, builder, sig.args[0], args[0])
        own, of_left, step = _table(context, builder, sig.args[1], args[1])
        right, of_panel, _ = _table(context, builder, sig.args[4], args[4])
        lanes = _lanes(context)
        vector = ir.VectorType(_FLOAT, lanes)
        lefts = [
            builder.gep(own, [builder.add(builder.mul(row, of_left), builder.mul(args[3], step))])
            for row in cgutils.unpack_tuple(builder, args[2])
        ]

        def vectors(row: Any, low: int) -> list[Any]:
            places = (ir.Constant(of_out.type, low + lanes * v) for v in range(_TOGETHER))
            return [builder.bitcast(builder.gep(row, [p]), vector.as_pointer()) for p in places]

        for low in range(0, WIDTH, _TOGETHER * lanes):
            zero = ir.Constant(vector, [0.0] * lanes)
            sums = [[cgutils.alloca_once_value(builder, zero) for _ in range(_TOGETHER)] for _ in lefts]
            with cgutils.for_range(builder, args[5]) as loop:
                row = builder.gep(right, [builder.mul(loop.index, of_panel)])
                columns = [builder.load(v, align=4, typ=vector) for v in vectors(row, low)]
                at = builder.mul(loop.index, step)
                for address, of_row in zip(lefts, sums):
                    number = builder.load(builder.gep(address, [at]), align=4, typ=_FLOAT)
                    factor = _of_all(builder, number, lanes)
                    for total, column in zip(of_row, columns):
                        product = builder.fmul(factor, column, flags=("contract",))
                        before = builder.load(total, typ=vector)
                        builder.store(builder.fadd(before, product, flags=("contract",)), total)
            for n, of_row in enumerate(sums):
                row = builder.gep(into, [builder.mul(ir.Constant(of_out.type, n), of_out)])
                for total, place in zip(of_row, vectors(row, low)):
                    builder.store(builder.load(total, typ=vector), place, align=4)
        return context.get_dummy_value()

    return signature, codegen
