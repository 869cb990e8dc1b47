"""Calls through an address from compiled code."""

# ruff: noqa: ARG001 - numba reads the arguments of an intrinsic from its signature

from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

_DOUBLE = ir.DoubleType()
_POINTER = _DOUBLE.as_pointer()


def _data(context: Any, builder: Any, array_type: Any, array: Any, offset: Any) -> Any:
    pointer = context.make_array(array_type)(context, builder, array).data
    return builder.gep(pointer, [offset])


def _function(builder: Any, address: Any, result: Any, arguments: list[Any]) -> Any:
    kind = ir.FunctionType(result, arguments)
    return builder.inttoptr(address, kind.as_pointer())


@intrinsic  # type: ignore[untyped-decorator]
def pointer(typing: Any, array: Any) -> Any:
    """Return the pointer to the first number of a contiguous array, which the caller keeps alive.

    Numba counts references to an array at every call it is handed to; a pointer costs nothing.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _data(context, builder, signature.args[0], arguments[0], cgutils.intp_t(0))

    return types.CPointer(array.dtype)(array), generate


@intrinsic  # type: ignore[untyped-decorator]
def offset(typing: Any, start: Any, count: Any) -> Any:
    """Return the pointer that begins `count` numbers behind `start`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.gep(arguments[0], [arguments[1]])

    return start(start, types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def no_vectorise(typing: Any) -> Any:
    """Prevent vectorisation of a loop with few iterations.

    An empty piece of assembly, which the compiler neither vectorizes nor removes; it becomes no instruction.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        builder.asm(ir.FunctionType(ir.VoidType(), []), "", "", [], True)
        return context.get_dummy_value()

    return types.void(), generate


@intrinsic  # type: ignore[untyped-decorator]
def call_model(typing: Any, address: Any, t: Any, x: Any, u: Any, p: Any, force: Any, out: Any) -> Any:
    """Call a function of signature ``model``; `x` ... `out` are pointers to float64, or contiguous arrays."""
    signature = types.void(types.int64, types.float64, x, u, p, force, out)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function = _function(builder, arguments[0], ir.VoidType(), [_DOUBLE, *[_POINTER] * 5])
        zero = cgutils.intp_t(0)
        pointers = [
            value if isinstance(kind, types.CPointer) else _data(context, builder, kind, value, zero)
            for kind, value in zip(signature.args[2:], arguments[2:], strict=True)
        ]
        builder.call(function, [arguments[1], *pointers])
        return context.get_dummy_value()

    return signature, generate


@intrinsic  # type: ignore[untyped-decorator]
def call_law(
    typing: Any,
    address: Any,
    t: Any,
    q: Any,
    rate: Any,
    acceleration: Any,
    load: Any,
    stiffness: Any,
    values: Any,
    z: Any,
    dz: Any,
) -> Any:
    """Call a function of signature ``law``; the last three are pointers to float64."""
    number = types.float64
    signature = number(types.int64, *[number] * 6, values, z, dz)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function = _function(builder, arguments[0], _DOUBLE, [*[_DOUBLE] * 6, *[_POINTER] * 3])
        return builder.call(function, arguments[1:])

    return signature, generate


@intrinsic  # type: ignore[untyped-decorator]
def call_filter(
    typing: Any,
    address: Any,
    before: Any,
    after: Any,
    dt: Any,
    values: Any,
    values_at: Any,
    memory: Any,
    memory_at: Any,
    out: Any,
) -> Any:
    """Call a function of signature ``filter``."""
    index = types.int64
    signature = types.void(types.int64, before, after, types.float64, values, index, memory, index, out)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function = _function(
            builder, arguments[0], ir.VoidType(), [_POINTER, _POINTER, _DOUBLE, *[_POINTER] * 3]
        )
        zero = cgutils.intp_t(0)
        kinds = signature.args
        builder.call(
            function,
            [
                _data(context, builder, kinds[1], arguments[1], zero),
                _data(context, builder, kinds[2], arguments[2], zero),
                arguments[3],
                _data(context, builder, kinds[4], arguments[4], arguments[5]),
                _data(context, builder, kinds[6], arguments[6], arguments[7]),
                _data(context, builder, kinds[8], arguments[8], zero),
            ],
        )
        return context.get_dummy_value()

    return signature, generate
