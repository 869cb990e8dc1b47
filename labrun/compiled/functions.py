"""Functions compiled to machine code that are called through their address.

Every model equation and every effect is compiled once to a C function of one fixed signature (`numba.cfunc`), and kept
on disk by numba. The integrator takes addresses, so that nothing is compiled anew for a combination of model and
effects, and a plugin's function runs exactly as a built-in one does.
"""

import ctypes
import functools
import hashlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any, Literal, Protocol, TypeVar, cast

import numpy as np

Signature = Literal["model", "law", "filter"]
"""
``model``  ``(t, x, u, p, force, out) -> None``
    derivative, output and site functions of a model; all but `t` point to float64.
``law``    ``(t, q, rate, acceleration, load, stiffness, values, z, dz) -> force``
    force of a joint or body effect; the last three point to float64.
``filter`` ``(before, after, dt, values, memory, out) -> None``
    input and output effects; all but `dt` point to float64.
"""


class Pointer(Protocol):
    """What compiled functions see of an array: float64 values by index, no length."""

    def __getitem__(self, index: int, /) -> float: ...

    def __setitem__(self, index: int, value: float, /) -> None: ...


class IntPointer(Protocol):
    """What compiled functions see of an array of integers: by index, no length."""

    def __getitem__(self, index: int, /) -> int: ...


Function = TypeVar("Function", bound=Callable[..., Any])
_SCALARS_FIRST = {"model": (1, 5), "law": (6, 3)}


@dataclass(frozen=True)
class NativeFunction:
    """A Python function of a fixed signature, compiled when its address is first asked for.

    Attributes
    ----------
    signature
        Which of the fixed signatures it has.
    provide
        Returns the Python function; kept instead of the function itself so that generated code, too, can be pickled.
    """

    signature: Signature
    provide: Callable[[], Callable[..., Any]]

    @property
    def python(self) -> Callable[..., Any]:
        """The function as plain Python, callable with arrays in place of pointers."""
        return self.provide()

    @property
    def address(self) -> int:
        """Address of the machine code; valid for the life of this process."""
        return int(compiled(self.signature, self.provide()).address)


class ThroughAddresses(NativeFunction):
    """A native function of signature ``model`` that has no plain Python form, because it follows addresses."""

    @property
    def python(self) -> Callable[..., Any]:
        """The compiled function, callable with arrays as any other."""
        doubles = ctypes.POINTER(ctypes.c_double)
        called = ctypes.CFUNCTYPE(None, ctypes.c_double, *[doubles] * 5)(self.address)

        def function(t: float, *arrays: Any) -> None:
            called(t, *(array.ctypes.data_as(doubles) for array in arrays))

        return function


def native(signature: Signature, function: Callable[..., Any]) -> NativeFunction:
    """Wrap a module-level function of a plugin or of labrun.

    Parameters
    ----------
    signature
        See `Signature`.
    function
        Written in what numba compiles: arithmetic, `math`, indexing of its pointers, module-level constants
        (numbers or NumPy arrays, frozen when it is compiled).
    """
    return NativeFunction(signature, functools.partial(_itself, function))


def _itself(function: Callable[..., Any]) -> Callable[..., Any]:
    return function


@functools.cache
def compiled(signature: Signature, function: Callable[..., Any]) -> Any:
    """Compile, or load from numba's cache on disk; returns the `numba.cfunc` object (`.address`, `.cache_hits`)."""
    from numba import cfunc, types

    number, pointer = types.float64, types.CPointer(types.float64)
    if signature == "filter":
        kind = types.void(pointer, pointer, number, pointer, pointer, pointer)
    else:
        scalars, pointers = _SCALARS_FIRST[signature]
        result = types.void if signature == "model" else number
        kind = result(*[number] * scalars, *[pointer] * pointers)
    # division by zero gives inf as in NumPy: a simulation that blows up is reported, a callback cannot raise
    return cfunc(kind, cache=True, error_model="numpy")(fresh(function))


def kernel(function: Function) -> Function:
    """Compile a function on its first call, without the GIL, and keep it on disk."""
    from numba import njit

    return cast("Function", njit(cache=True, nogil=True, error_model="numpy")(fresh(function)))


def inlined(function: Function) -> Function:
    """Compile a function into the kernels that call it: for what is called at every step, where a call costs most."""
    from numba import njit

    return cast(
        "Function", njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(fresh(function))
    )


_VARIABLE = "__labrun_sources"


def fresh(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the same function with a digest of everything it is compiled from in its closure.

    Numba stores compiled code by the time stamp and size of the file a function stands in. A function that calls
    compiled functions of other files, or uses their constants, would keep running old code after those files change;
    and files out of a wheel carry stamps that never change. Numba also tells functions apart by the contents of their
    closure: a closure variable that holds a digest of all those sources closes the gap.
    """
    if not isinstance(function, FunctionType) or function.__closure__:
        return function
    code = function.__code__.replace(co_freevars=(_VARIABLE,))
    closure = (CellType(_digest(function)),)
    keyed = FunctionType(code, function.__globals__, function.__name__, function.__defaults__, closure)
    return functools.update_wrapper(keyed, function)


def _digest(function: FunctionType) -> str:
    digest = hashlib.sha256()
    seen: set[CodeType] = set()
    waiting = [function]
    while waiting:
        current = waiting.pop()
        if current.__code__ in seen:
            continue
        seen.add(current.__code__)
        digest.update(_contents(current.__code__.co_filename))
        for name, value in _globals_used(current):
            callee = getattr(value, "py_func", None) or getattr(value, "_defn", None)
            if isinstance(callee, FunctionType):
                waiting.append(callee)
            elif isinstance(value, np.ndarray):
                digest.update(name.encode() + value.tobytes())
            elif isinstance(value, int | float | tuple):
                digest.update(f"{name}={value!r}".encode())
    return digest.hexdigest()


def _globals_used(function: FunctionType) -> Iterator[tuple[str, Any]]:
    names = function.__code__.co_names
    for name in names:
        value = function.__globals__.get(name)
        if isinstance(value, ModuleType):
            if not value.__name__.startswith(("math", "numpy", "numba")):
                yield from ((other, getattr(value, other)) for other in names if hasattr(value, other))
        else:
            yield name, value


@functools.cache
def _contents(filename: str) -> bytes:
    try:
        return Path(filename).read_bytes()
    except OSError:  # defined without a file, for example in a notebook
        return b""
