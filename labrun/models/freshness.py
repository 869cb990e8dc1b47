"""Compiled code on disk that notices when what it was compiled from changes.

Numba stores compiled code by the time stamp and size of the file a function stands in. A function that calls compiled
functions of other files, or uses their constants, would keep running old code after those files change; and files out
of a wheel carry stamps that never change. Numba also tells functions apart by the contents of their closure, so a
closure variable that holds a digest of all those sources closes the gap.
"""

import functools
import hashlib
from collections.abc import Callable, Iterator
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any

import numpy as np

_VARIABLE = "__labrun_sources"


def fresh(function: Callable[..., Any]) -> Callable[..., Any]:
    """Return the same function with a digest of everything it is compiled from in its closure."""
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
        one = waiting.pop()
        if one.__code__ in seen:
            continue
        seen.add(one.__code__)
        digest.update(_contents(one.__code__.co_filename))
        for name, value in _globals_used(one):
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
