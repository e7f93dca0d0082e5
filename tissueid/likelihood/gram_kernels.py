"""Compiled Gram matrices of design rows: a row a sample, columns running fastest.

A product Z' Z of many samples and few columns is bound by loads, not by multiplications, unless sums stay in
registers while the samples run past.  Entries of it are made a tile at a time: :data:`LANES` rows, one number
of a sample each, against up to :data:`WIDE` registers of :data:`LANES` columns.  A sample costs as many loads
as the tile has rows and registers side by side, 11 for 24 multiply-adds of a register, and nothing is added
across a register.  Only tiles on and above the diagonal are made.

Columns times a power of one weight make a Gram matrix each: the columns x^p s_k of a stiffness that grows
with depth need 2 degree + 1 of the small products S' diag(x^q) S, not one of all columns with each other.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import binding, ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, is_jitted
from numpy.typing import NDArray

from tissueid.compiled import kernel

__all__ = [
    "BLOCK",
    "LANES",
    "add_grams",
    "add_products",
    "aligned_zeros",
    "chunk_samples",
    "mirrored",
    "places",
    "plain_grams",
    "tiled_columns",
    "tiled_grams",
]

FloatArray = NDArray[np.float64]

#: Numbers that a register of this processor holds; the number of columns of a design is a multiple of it.
LANES = 8 if binding.get_host_cpu_features().get("avx512f", False) else 4
#: Registers side by side in a tile: with four lanes its sums and factors fill sixteen registers.
WIDE = 3
#: Samples whose products are summed before they are added up: their rows stay in the second-level cache.
BLOCK = 256
#: Numbers in the rows of a chunk of samples.
CELLS = 144 * 1024
#: Numbers in a line of the cache.
LINE = 8

_WORD = ir.IntType(64)
_INDEX = ir.IntType(32)
_NUMBER = ir.DoubleType()
_REGISTER = ir.VectorType(_NUMBER, LANES)
_NUMBER_BYTES = 8
#: Multiply and add in one, where the processor can.
_FUSED = ("contract",)


def tiled_columns(count: int) -> int:
    """The next multiple of :data:`LANES`."""
    return -(-count // LANES) * LANES


def chunk_samples(columns: int) -> int:
    """Samples whose design rows are made at a time, where there are so many columns."""
    return max(CELLS // columns, 1)


def aligned_zeros(*shape: int) -> FloatArray:
    """Zeros that begin where a line of the cache does: stores across two lines take twice as long."""
    size = math.prod(shape)
    room = np.zeros(size + LINE)
    start = -(room.ctypes.data // room.itemsize) % LINE
    return room[start : start + size].reshape(shape)


def mirrored(upper: FloatArray) -> FloatArray:
    """Symmetric matrices from what stands on and above their diagonals; shape (..., m, m)."""
    return np.asarray(np.triu(upper) + np.swapaxes(np.triu(upper, 1), -1, -2))


class _Rows:
    """A matrix as the code of a tile sees it: rows of a stride, each without gaps."""

    def __init__(self, context: Any, builder: Any, kind: Any, value: Any) -> None:
        array = context.make_array(kind)(context, builder, value)
        self.count = builder.extract_value(array.shape, 0)
        self._stride = builder.extract_value(array.strides, 0)
        self._first = builder.ptrtoint(array.data, _WORD)
        self._builder = builder

    def at(self, row: Any, column: int, kind: Any) -> Any:
        """Pointer to what is a number or a register of them."""
        inside = self._builder.mul(row, self._stride)
        place = self._builder.add(inside, _WORD(_NUMBER_BYTES * column))
        return self._builder.inttoptr(self._builder.add(self._first, place), kind.as_pointer())


def _zero(builder: Any) -> Any:
    """A variable of the size of a register."""
    return cgutils.alloca_once_value(builder, _REGISTER([0.0] * LANES))  # type: ignore[no-untyped-call]


def _emit_products(builder: Any, left: _Rows, right: _Rows, sums: list[list[Any]]) -> None:
    """Emit the loop over samples; ``sums`` are variables, which the compiler keeps in registers."""
    with cgutils.for_range(builder, left.count) as loop:
        others = [
            builder.load(right.at(loop.index, LANES * c, _REGISTER), align=_NUMBER_BYTES)
            for c in range(len(sums[0]))
        ]
        for r, row in enumerate(sums):
            number = builder.load(left.at(loop.index, r, _NUMBER))
            one = builder.insert_element(_REGISTER(ir.Undefined), number, _INDEX(0))
            everywhere = builder.shuffle_vector(one, one, ir.VectorType(_INDEX, LANES)([0] * LANES))
            for other, variable in zip(others, row, strict=True):
                product = builder.fmul(everywhere, other, flags=_FUSED)
                builder.store(builder.fadd(builder.load(variable), product, flags=_FUSED), variable)


def _tile(wide: int) -> Any:
    """A function ``add(left, right, out)`` of compiled code: ``out += left.T @ right``, kept in registers.

    ``left`` has :data:`LANES` columns, ``right`` and ``out`` ``wide`` times as many; no gaps inside a row.
    """

    @intrinsic
    def add(typing_context, left, right, out):  # type: ignore[no-untyped-def] # noqa: ARG001
        def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            a, b, target = (
                _Rows(context, builder, kind, value)
                for kind, value in zip(signature.args, arguments, strict=True)
            )
            sums = [[_zero(builder) for _ in range(wide)] for _ in range(LANES)]
            _emit_products(builder, a, b, sums)
            for r, row in enumerate(sums):
                for c, variable in enumerate(row):
                    place = target.at(_WORD(r), LANES * c, _REGISTER)
                    before = builder.load(place, align=_NUMBER_BYTES)
                    builder.store(builder.fadd(before, builder.load(variable)), place, align=_NUMBER_BYTES)
            return context.get_dummy_value()

        return types.void(left, right, out), emit

    return add


_add_one, _add_two, _add_three = (_tile(wide) for wide in range(1, WIDE + 1))


@kernel()
def add_products(
    left: FloatArray, right: FloatArray, first: int, plain: int, block: int, out: FloatArray
) -> None:
    """Add ``left.T @ right`` on and above the diagonal, from row ``first`` on.

    Columns behind the first ``plain`` are blocks of ``block``, all multiples of :data:`LANES`.  Where a row
    meets another block than its own, columns that stand in theirs before the row in its own are left out.
    """
    m = out.shape[0]
    for k in range(first, m, LANES):
        mine, target = left[:, k : k + LANES], out[k : k + LANES]
        before = (k - plain) % block if k >= plain else 0
        c = k
        while c < m:
            stop = min(plain + ((c - plain) // block + 1) * block, m) if k >= plain else m
            while c + WIDE * LANES <= stop:
                _add_three(mine, right[:, c : c + WIDE * LANES], target[:, c : c + WIDE * LANES])
                c += WIDE * LANES
            if c + 2 * LANES == stop:
                _add_two(mine, right[:, c:stop], target[:, c:stop])
            elif c + LANES == stop:
                _add_one(mine, right[:, c:stop], target[:, c:stop])
            c = stop + before


@kernel()
def tiled_grams(rows: FloatArray, weight: FloatArray, plain: int, out: FloatArray) -> None:
    """:func:`add_grams`, compiled."""
    samples, m = rows.shape
    # power q is the product of rows that are scaled by half of it, rounded up and down
    scaled = np.empty((out.shape[0] // 2, min(BLOCK, samples), m))
    for begin in range(0, samples, BLOCK):
        block = rows[begin : begin + BLOCK]
        n = block.shape[0]
        add_products(block, block, 0, 0, m, out[0])
        for q in range(1, out.shape[0]):
            high, low = (q + 1) // 2, q // 2
            right = scaled[low - 1, :n] if low > 0 else block
            left = scaled[high - 1, :n]
            if high > low:
                for i in range(n):
                    w, row, product = weight[begin + i], right[i], left[i]
                    for c in range(m):
                        product[c] = w * row[c]
            add_products(left, right, plain, 0, m, out[q])


def plain_grams(rows: FloatArray, weight: FloatArray, plain: int, out: FloatArray) -> None:
    """:func:`add_grams` as matrix products, for a run without compilation."""
    out[0] += rows.T @ rows
    for q in range(1, out.shape[0]):
        out[q, plain:] += (rows[:, plain:].T * weight**q) @ rows


def add_grams(rows: FloatArray, weight: FloatArray, plain: int, out: FloatArray) -> None:
    """Add weighted Gram matrices: ``sum_i w_i^q z_ik z_il``.

    Parameters
    ----------
    rows : ndarray, shape (samples, m)
        Design rows, m a multiple of :data:`LANES`, without gaps inside a row.
    weight : ndarray, shape (samples,)
        Looked at where more than one power is asked for.
    plain : int
        So many leading columns, a multiple of :data:`LANES`, take part in the power zero alone.
    out : ndarray, shape (powers, m, m)
        One matrix a power q, without gaps; right on and above the diagonal (:func:`mirrored`).
    """
    (tiled_grams if is_jitted(tiled_grams) else plain_grams)(rows, weight, plain, out)


@kernel()
def places(label: NDArray[np.int64], kinds: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows that put samples of one label behind one another, in their order.

    Parameters
    ----------
    label : ndarray of int, shape (count,)
        In [0, kinds).
    kinds : int

    Returns
    -------
    place : ndarray of int, shape (count,)
    bound : ndarray of int, shape (kinds + 1,)
        First row of each label, and the one behind the last.
    """
    bound = np.zeros(kinds + 1, dtype=np.int64)
    for one in label:
        bound[one + 1] += 1
    for k in range(kinds):
        bound[k + 1] += bound[k]
    following = bound.copy()
    place = np.empty(label.size, dtype=np.int64)
    for i in range(label.size):
        place[i] = following[label[i]]
        following[label[i]] += 1
    return place, bound
