"""Functions compiled to machine code that are called through their address.

Every model equation and every effect is compiled once to a C function of one fixed signature (`numba.cfunc`), and kept
on disk by numba. The integrator takes addresses, so that nothing is compiled anew for a combination of model and
effects, and a plugin's function runs exactly as a built-in one does.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

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

    from labrun.models.freshness import fresh

    number, pointer = types.float64, types.CPointer(types.float64)
    if signature == "filter":
        kind = types.void(pointer, pointer, number, pointer, pointer, pointer)
    else:
        scalars, pointers = _SCALARS_FIRST[signature]
        result = types.void if signature == "model" else number
        kind = result(*[number] * scalars, *[pointer] * pointers)
    # division by zero gives inf as in NumPy: a simulation that blows up is reported, a callback cannot raise
    return cfunc(kind, cache=True, error_model="numpy")(fresh(function))
