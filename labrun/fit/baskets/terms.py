"""Terms of a basket: ``a``, ``a'``, ``a''``, ``a^2``, ``a*b`` of signals on an even time base."""

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from labrun.errors import RequestError
from labrun.toml import nearest

FloatArray = NDArray[np.float64]

BASKETS: dict[str, list[str]] = {
    "a,b": ["a", "b"],
    "+a',b'": ["a", "b", "a'", "b'"],
    "+a'',b''": ["a", "b", "a'", "b'", "a''", "b''"],
    "+a^2,b^2": ["a", "b", "a^2", "b^2"],
    "+a^3,b^3": ["a", "b", "a^2", "b^2", "a^3", "b^3"],
    "+a^4,b^4": ["a", "b", "a^2", "b^2", "a^3", "b^3", "a^4", "b^4"],
    "a,a',a^2,b,b',b^2": ["a", "a'", "a^2", "b", "b'", "b^2"],
}
"""Those of Table 5.3."""

_FACTOR = re.compile(r"([A-Za-z_]\w*)('{0,4})(?:\^([1-9]))?")


def column(term: str, signals: Mapping[str, FloatArray], step_s: float) -> FloatArray:
    """Return a term's values, (n,); derivatives are per second, by central differences.

    Raises
    ------
    RequestError
        A term that cannot be read, or a signal that is not among the inputs.
    """
    values = np.ones(len(next(iter(signals.values()))))
    for factor in term.replace(" ", "").split("*"):
        found = _FACTOR.fullmatch(factor)
        if found is None:
            raise RequestError(
                f"a basket has a term that cannot be read: {term!r}",
                hint="terms are like a, a', a'', a^2, a*b",
            )
        name, primes, power = found.groups()
        if name not in signals:
            near = nearest(name, list(signals))
            hint = f"did you mean {near}?" if near else f"inputs are {', '.join(signals)}"
            raise RequestError(
                f"a basket's term {term!r} needs {name}, which is not among the inputs", hint=hint
            )
        one = signals[name]
        for _ in primes:
            one = np.gradient(one, step_s, edge_order=2)
        values = values * one ** int(power or 1)
    return values


def unit(term: str, output_unit: str, units: Mapping[str, str]) -> str:
    """Return the unit of a term's coefficient."""
    below = []
    seconds = 0
    for factor in term.replace(" ", "").split("*"):
        name, primes, power = _FACTOR.fullmatch(factor).groups()  # type: ignore[union-attr]
        below.append(f"{units.get(name, '1')}{'^' + power if power else ''}")
        seconds += len(primes) * int(power or 1)
    above = f" s{'^' + str(seconds) if seconds > 1 else ''}" if seconds else ""
    return f"{output_unit}{above}/{' '.join(below) if len(below) == 1 else '(' + ' '.join(below) + ')'}"
