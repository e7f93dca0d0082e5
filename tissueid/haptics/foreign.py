"""Beyond compiled Python: C functions by name or address, and words that other processes see in order.

A loop is cached on disk and runs where a driver is absent.  Without compilation both are called by ctypes.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

from tissueid.arrays import IntArray
from tissueid.compiled import kernel, tick_kernel

_UNCOMPILED = bool(getattr(config, "DISABLE_JIT", False))
_CTYPES: dict[Any, Any] = {
    types.int8: ctypes.c_int8,
    types.int32: ctypes.c_int32,
    types.uint8: ctypes.c_uint8,
    types.uint32: ctypes.c_uint32,
    types.int64: ctypes.c_int64,
    types.float64: ctypes.c_double,
}


def libc_function(name: str, result: Any, *arguments: Any) -> Callable[..., Any]:
    """A function of libc for compiled code; pointers are int64, ``array.ctypes.data``."""
    if not _UNCOMPILED:
        return types.ExternalFunction(name, result(*arguments))
    function = getattr(ctypes.CDLL(None, use_errno=True), name)
    function.restype = _CTYPES[result]
    function.argtypes = [_CTYPES[argument] for argument in arguments]
    return function  # type: ignore[no-any-return]


def by_address(result: Any, *arguments: Any) -> Callable[..., Any]:
    """A caller ``call(address, (arguments, ...))`` of C functions of one signature."""
    if _UNCOMPILED:
        prototype = ctypes.CFUNCTYPE(_CTYPES[result], *(_CTYPES[argument] for argument in arguments))
        return lambda address, values: prototype(address)(*values)

    @intrinsic
    def call(typing_context, address, values):  # type: ignore[no-untyped-def] # noqa: ARG001
        """Call the function at an address with a tuple of arguments."""
        if not isinstance(address, types.Integer) or len(values) != len(arguments):
            return None

        def emit(context: Any, builder: Any, signature: Any, given: Any) -> Any:
            kind = ir.FunctionType(
                context.get_value_type(result), [context.get_value_type(argument) for argument in arguments]
            )
            pointer = builder.inttoptr(given[0], kind.as_pointer())
            converted = [
                context.cast(builder, builder.extract_value(given[1], i), signature.args[1][i], argument)
                for i, argument in enumerate(arguments)
            ]
            return builder.call(pointer, converted)

        return result(types.int64, values), emit

    return call


#: poll(2): an int32 descriptor, int16 events and int16 returned events, here as one little-endian word.
POLL_IN, POLL_OUT, POLL_BROKEN = 0x1, 0x4, 0x8 | 0x10 | 0x20
_EVENTS_SHIFT, _RETURNED_SHIFT = 32, 48
_poll = libc_function("poll", types.int32, types.int64, types.int64, types.int32)


@tick_kernel
def ready(descriptor: int, events: int, word: IntArray) -> int:
    """Events of a descriptor that hold now, by a word of room; POLL_BROKEN bits if the other end is gone."""
    word[0] = descriptor | (events << _EVENTS_SHIFT)
    if _poll(word.ctypes.data, 1, 0) < 0:
        return 0
    return int((word[0] >> _RETURNED_SHIFT) & 0xFFFF)


_WORD_BYTES = 8


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
