"""Compiled: MuJoCo as the derivative and the outputs of a model. Importing this imports numba.

MuJoCo is called through the addresses of its C functions, without Python, so that the integrator, the effects and
their solution for accelerations are those of any model. A table of integers tells where everything is in memory.
"""

# ruff: noqa: ARG001 - numba reads the arguments of an intrinsic from its signature

import math
from typing import Any

from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic

from labrun.compiled import Pointer, kernel
from labrun.models.mjcf.plant import (
    APPLY,
    DATA,
    FORCES,
    FORCES_COUNT,
    FORWARD,
    INPUTS,
    INPUTS_ADD,
    INPUTS_COUNT,
    LAST,
    MODEL,
    OUTPUTS,
    OUTPUTS_COUNT,
    OUTPUTS_NEED_FORWARD,
    QUATERNION_VELOCITIES,
    QUATERNIONS,
    QUATERNIONS_COUNT,
    RATES,
    SCRATCH,
    SITES,
    SITES_COUNT,
    STATES,
    STATES_COUNT,
    VALUES_COUNT,
    WARNINGS,
    WARNINGS_COUNT,
)  # fmt: skip


@intrinsic  # type: ignore[untyped-decorator]
def numbers(typing: Any, address: Any) -> Any:
    """Return the float64 values at an address, by index."""
    return _pointer(types.float64, ir.DoubleType())


@intrinsic  # type: ignore[untyped-decorator]
def count(typing: Any, address: Any) -> Any:
    """Return the int32 at an address."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        short = builder.load(builder.inttoptr(arguments[0], ir.IntType(32).as_pointer()))
        return builder.sext(short, ir.IntType(64))

    return types.int64(types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def integers(typing: Any, address: Any) -> Any:
    """Return the int64 values at an address, by index."""
    return _pointer(types.int64, ir.IntType(64))


def _pointer(kind: Any, llvm: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], llvm.as_pointer())

    return types.CPointer(kind)(types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def call_back(typing: Any, function: Any) -> Any:
    """Call a function that takes nothing and returns an integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        kind = ir.FunctionType(ir.IntType(64), [])
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), [])

    return types.int64(types.int64), generate


@intrinsic  # type: ignore[untyped-decorator]
def call_forward(typing: Any, function: Any, model: Any, data: Any, skip_sensors: Any) -> Any:
    """Call ``mj_forwardSkip(model, data, mjSTAGE_NONE, skip_sensors)``."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        byte, integer = ir.IntType(8).as_pointer(), ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [byte, byte, integer, integer])
        called = builder.inttoptr(arguments[0], kind.as_pointer())
        pointers = [builder.inttoptr(argument, byte) for argument in arguments[1:3]]
        builder.call(called, [*pointers, ir.Constant(integer, 0), builder.trunc(arguments[3], integer)])
        return context.get_dummy_value()

    return types.void(*[types.int64] * 4), generate


@kernel
def warnings(table: Any) -> int:
    """Return how often MuJoCo has warned that it could not evaluate its equations."""
    total, addresses = 0, integers(table[WARNINGS])
    for index in range(table[WARNINGS_COUNT]):
        total += count(addresses[index])
    return total


@kernel
def forward(table: Any, skip_sensors: int) -> bool:
    """Let MuJoCo evaluate its equations; tell whether it could."""
    before = warnings(table)
    call_forward(table[FORWARD], table[MODEL], table[DATA], skip_sensors)
    return bool(warnings(table) == before)


@kernel
def settle(table: Any) -> bool:
    """Have the attributes written that parameters set, if any changed; tell whether they are possible.

    The values stand in the scratch memory. Comparing costs little, writing and MuJoCo's derived constants cost much.
    """
    wanted, last = numbers(table[SCRATCH]), numbers(table[LAST])
    changed = False
    for k in range(table[VALUES_COUNT]):
        if not math.isfinite(wanted[k]):
            return False
        if wanted[k] != last[k]:
            changed = True
            last[k] = wanted[k]
    return not changed or call_back(table[APPLY]) != 0


@kernel
def write_point(table: Any, x: Pointer, u: Pointer, force: Pointer) -> bool:
    """Write state, inputs and site forces to MuJoCo's memory; tell whether all are finite, which MuJoCo needs."""
    forces = numbers(table[FORCES])
    for k in range(table[FORCES_COUNT]):
        forces[k] = 0.0
    addresses = integers(table[STATES])
    for k in range(table[STATES_COUNT]):
        if not math.isfinite(x[k]):
            return False
        numbers(addresses[k])[0] = x[k]
    addresses, adds = integers(table[INPUTS]), integers(table[INPUTS_ADD])
    for k in range(table[INPUTS_COUNT]):
        if not math.isfinite(u[k]):
            return False
        if adds[k] != 0:
            numbers(addresses[k])[0] += u[k]
        else:
            numbers(addresses[k])[0] = u[k]
    addresses = integers(table[SITES])
    for k in range(table[SITES_COUNT]):
        if not math.isfinite(force[k]):
            return False
        numbers(addresses[k])[0] += force[k]
    return True


@kernel
def slope(table: Any, x: Pointer, u: Pointer, force: Pointer, out: Pointer) -> None:
    """Write the derivative of every state; NaN where MuJoCo could not be asked."""
    count = table[STATES_COUNT]
    if not (settle(table) and write_point(table, x, u, force) and forward(table, 1)):
        for k in range(count):
            out[k] = math.nan
        return
    addresses = integers(table[RATES])
    for k in range(count):
        if addresses[k] != 0:
            out[k] = numbers(addresses[k])[0]
    # dq/dt = q (0, w) / 2, with the angular velocity w in the body's own frame
    firsts, spins = integers(table[QUATERNIONS]), integers(table[QUATERNION_VELOCITIES])
    for k in range(table[QUATERNIONS_COUNT]):
        w, first = numbers(spins[k]), firsts[k]
        a, b, c, d = x[first], x[first + 1], x[first + 2], x[first + 3]
        out[first] = 0.5 * (-b * w[0] - c * w[1] - d * w[2])
        out[first + 1] = 0.5 * (a * w[0] + c * w[2] - d * w[1])
        out[first + 2] = 0.5 * (a * w[1] - b * w[2] + d * w[0])
        out[first + 3] = 0.5 * (a * w[2] + b * w[1] - c * w[0])


@kernel
def reading(table: Any, x: Pointer, u: Pointer, force: Pointer, out: Pointer) -> None:
    """Write every output; NaN where MuJoCo could not be asked."""
    count = table[OUTPUTS_COUNT]
    asked = settle(table) and write_point(table, x, u, force)
    if asked and table[OUTPUTS_NEED_FORWARD] != 0:
        asked = forward(table, 0)
    if not asked:
        for k in range(count):
            out[k] = math.nan
        return
    addresses = integers(table[OUTPUTS])
    for k in range(count):
        out[k] = numbers(addresses[k])[0]
