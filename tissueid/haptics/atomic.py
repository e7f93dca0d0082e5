"""Loads and stores of one 64-bit integer that other processes see in order; free on x86-64, not on ARM."""

from __future__ import annotations

from typing import Any

from numba import config, types
from numba.extending import intrinsic

from tissueid.arrays import IntArray
from tissueid.compiled import kernel

_WORD_BYTES = 8
_UNCOMPILED = bool(getattr(config, "DISABLE_JIT", False))


def _address(context: Any, builder: Any, array_type: Any, array: Any) -> Any:
    """Pointer to the first word of an array."""
    return context.make_array(array_type)(context, builder, array).data


@intrinsic
def _store(typing_context, cell, value):  # type: ignore[no-untyped-def] # noqa: ARG001
    """Atomic release store into ``cell[0]``, and a release fence."""
    if not (isinstance(cell, types.Array) and cell.dtype == types.int64 and value == types.int64):
        return None

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _address(context, builder, signature.args[0], arguments[0])
        builder.store_atomic(arguments[1], pointer, ordering="release", align=_WORD_BYTES)
        builder.fence("release")
        return context.get_dummy_value()

    return types.void(cell, value), emit


@intrinsic
def _load(typing_context, cell):  # type: ignore[no-untyped-def] # noqa: ARG001
    """Atomic acquire load of ``cell[0]``, after an acquire fence."""
    if not (isinstance(cell, types.Array) and cell.dtype == types.int64):
        return None

    def emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _address(context, builder, signature.args[0], arguments[0])
        builder.fence("acquire")
        return builder.load_atomic(pointer, ordering="acquire", align=_WORD_BYTES)

    return types.int64(cell), emit


@kernel(error_model="python")
def _store_release(cell: IntArray, value: int) -> None:
    _store(cell, value)  # type: ignore[call-arg] # the typing context is not the caller's


@kernel(error_model="python")
def _load_acquire(cell: IntArray) -> int:
    return _load(cell)  # type: ignore[call-arg]


def _plain_store(cell: IntArray, value: int) -> None:
    """Without compilation: one aligned word, written at once on every machine numpy runs on."""
    cell[0] = value


def _plain_load(cell: IntArray) -> int:
    return int(cell[0])


#: ``store_release(cell, value)``: set ``cell[0]``, int64, after everything written before.
store_release = _plain_store if _UNCOMPILED else _store_release
#: ``load_acquire(cell)``: ``cell[0]``, before everything read after.
load_acquire = _plain_load if _UNCOMPILED else _load_acquire
