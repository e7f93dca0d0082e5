"""C functions that compiled loops call: libc by name, drivers by an address that is an argument.

A loop is cached on disk and runs where a driver is absent.  Without compilation both are called by ctypes.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

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
    if not getattr(config, "DISABLE_JIT", False):
        return types.ExternalFunction(name, result(*arguments))
    function = getattr(ctypes.CDLL(None, use_errno=True), name)
    function.restype = _CTYPES[result]
    function.argtypes = [_CTYPES[argument] for argument in arguments]
    return function  # type: ignore[no-any-return]


def by_address(result: Any, *arguments: Any) -> Callable[..., Any]:
    """A caller ``call(address, (arguments, ...))`` of C functions of one signature."""
    if getattr(config, "DISABLE_JIT", False):
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
