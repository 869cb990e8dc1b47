"""A transfer function with a dead time: what a fit hands over, what a controller is designed on, and its TOML.

As TOML it is one table for each response, or the keys alone::

    [magnitude]
    gain = 0.0091         # first order: gain, lag_s, dead_s
    lag_s = 0.34
    dead_s = 0.28
    input_unit = "deg"
    output_unit = "N"

    [angle]
    numerator = [-0.87]   # any other: highest power of s first
    denominator = [0.01, 0.2, 1.0]
    dead_s = 0.1

Keys that end in ``_ci95`` are read over: a fit writes its 95 % intervals so.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrun.arrays import FloatArray
from labrun.control import TransferTable, response_table
from labrun.errors import RequestError
from labrun.fit.transfer.response import step_response
from labrun.toml import Places, parsed, refusal, validate

ComplexArray = NDArray[np.complex128]
_NAMES = ("input_name", "output_name", "input_unit", "output_unit")
_INTERVAL = "_ci95"
_SOME_S = 1e-9
"""A shorter dead time is none to a reader: rounding of a search that ended at zero."""


class NamedTransferTable(TransferTable):
    """A transfer function in TOML, with names and units of what goes in and comes out."""

    input_name: str = ""
    output_name: str = ""
    input_unit: str = "1"
    output_unit: str = "1"


@dataclass(frozen=True, slots=True)
class TransferFunction:
    """``numerator(s) / denominator(s) * exp(-dead_s s)``, proper, of one input and one output.

    Attributes
    ----------
    numerator, denominator
        Coefficients, highest power of s first, as they were given but for leading zeros, which are dropped. Those that
        a fit gives are scaled so that the denominator's last coefficient is 1 (its first, if the last is zero).
    dead_s
        Dead time, s.
    input_name, output_name, input_unit, output_unit
        What goes in and comes out; the gain's unit is output_unit/input_unit.

    Raises
    ------
    RequestError
        No denominator, a numerator of higher order than it, a negative dead time, or numbers that are not finite.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    dead_s: float = 0.0
    input_name: str = ""
    output_name: str = ""
    input_unit: str = "1"
    output_unit: str = "1"

    def __post_init__(self) -> None:
        numerator, denominator = (
            _without_leading_zeros(self.numerator),
            _without_leading_zeros(self.denominator),
        )
        if not np.all(np.isfinite([*numerator, *denominator, self.dead_s])):
            raise RequestError(
                f"a transfer function needs finite numbers: {numerator} / {denominator}, {self.dead_s} s"
            )
        if denominator == (0.0,):
            raise RequestError("the denominator of a transfer function is zero")
        if len(numerator) > len(denominator):
            raise RequestError(
                f"a transfer function with {len(numerator) - 1} zeros and {len(denominator) - 1} poles is not proper",
                hint="give it at least as many poles as zeros",
            )
        if self.dead_s < 0:
            raise RequestError(f"a dead time cannot be negative: {self.dead_s:g} s")
        object.__setattr__(self, "numerator", numerator)
        object.__setattr__(self, "denominator", denominator)
        object.__setattr__(self, "dead_s", float(self.dead_s))

    @classmethod
    def first_order(cls, gain: float, lag_s: float, dead_s: float = 0.0, **names: str) -> "TransferFunction":
        """Return ``gain exp(-dead_s s) / (lag_s s + 1)``; `names` are names and units as of the class."""
        return cls((gain,), (lag_s, 1.0), dead_s, **names)

    @property
    def gain(self) -> float:
        """Static gain, output_unit/input_unit; infinite with a pole at zero."""
        if self.denominator[-1] == 0.0:
            return float("inf")
        return self.numerator[-1] / self.denominator[-1]

    @property
    def gain_unit(self) -> str:
        """Unit of the gain."""
        if self.input_unit == self.output_unit:
            return "1" if self.input_unit == "1" else f"{self.output_unit}/{self.input_unit}"
        return self.output_unit if self.input_unit == "1" else f"{self.output_unit}/{self.input_unit}"

    @property
    def poles(self) -> ComplexArray:
        """Poles, rad/s, slowest first."""
        return _sorted(np.roots(self.denominator))

    @property
    def zeros(self) -> ComplexArray:
        """Zeros, rad/s, slowest first; a dead time adds none."""
        return _sorted(np.roots(self.numerator))

    @property
    def order(self) -> int:
        """Number of poles."""
        return len(self.denominator) - 1

    @property
    def is_first_order(self) -> bool:
        """Tell whether it is a gain, a lag and a dead time: one pole, not at zero, and no zero."""
        return self.order == 1 and len(self.numerator) == 1 and self.denominator[-1] != 0.0

    @property
    def lag_s(self) -> float:
        """Time constant of a first-order transfer function, s. Raises RequestError: it is of another order."""
        if not self.is_first_order:
            raise RequestError(
                f"a transfer function with {self.order} poles and {len(self.numerator) - 1} zeros has no one lag",
                hint="its poles tell its time constants: fit it with fopdt for one lag",
            )
        return self.denominator[0] / self.denominator[1]

    @property
    def is_stable(self) -> bool:
        """Tell whether every pole lies left of the imaginary axis."""
        return bool(np.all(self.poles.real < 0.0))

    def to_control(self, pade_order: int | None = None) -> Any:
        """Return a ``control.TransferFunction`` with names of input and output.

        `pade_order`: order of the Padé approximation that stands for the dead time; None leaves the dead time out.
        """
        import control

        named = {
            key: value
            for key, value in (("inputs", self.input_name), ("outputs", self.output_name))
            if value and "." not in value
        }
        numerator, denominator = np.array(self.numerator), np.array(self.denominator)
        if pade_order and self.dead_s > 0.0:
            above, below = control.pade(self.dead_s, pade_order)
            numerator, denominator = np.polymul(numerator, above), np.polymul(denominator, below)
        return control.TransferFunction(numerator, denominator, **named)

    def frequency_response(self, omega_rad_s: ArrayLike) -> ComplexArray:
        """Return the complex gain at angular frequencies, rad/s, with the exact dead time."""
        s = 1j * np.asarray(omega_rad_s, dtype=float)
        ratio = np.polyval(self.numerator, s) / np.polyval(self.denominator, s)
        return np.asarray(ratio * np.exp(-self.dead_s * s))

    def step_response(self, time_s: ArrayLike) -> FloatArray:
        """Return the answer at any times to an input that is 0 before t = 0 and 1 from then on."""
        return step_response(self.numerator, self.denominator, self.dead_s, np.asarray(time_s, dtype=float))

    def to_table(self) -> dict[str, Any]:
        """Return it as the keys of a TOML table."""
        table: dict[str, Any] = {}
        if self.is_first_order:
            table |= {"gain": self.gain, "lag_s": self.lag_s}
        else:
            table |= {"numerator": list(self.numerator), "denominator": list(self.denominator)}
        table["dead_s"] = self.dead_s
        return table | {key: getattr(self, key) for key in _NAMES if getattr(self, key)}

    @classmethod
    def from_toml(
        cls, text: str, response: str | None = None, *, name: str = "transfer function"
    ) -> "TransferFunction":
        """Read one of a TOML text.

        Parameters
        ----------
        text
            Its keys at the top, or in a table for each response, as the fits write them.
        response
            Which table; not needed where there is one.
        name
            Of the file, for messages.

        Raises
        ------
        RequestError
            Not TOML, no such response, a key that is missing, unknown or of the wrong kind; with line and column.
        """
        data = parsed(text, name)
        table, path = response_table(data, name, response)
        keys, faults = validate(
            NamedTransferTable, {key: one for key, one in table.items() if not key.endswith(_INTERVAL)}, path
        )
        if keys is None:
            raise refusal(RequestError, name, Places(name, text, data).of_all(faults))
        return cls.of(keys)

    @classmethod
    def of(cls, table: NamedTransferTable) -> "TransferFunction":
        """Return that of a table."""
        above, below = table.numerator or (table.gain or 0.0,), table.denominator or (table.lag_s, 1.0)
        return cls(tuple(above), tuple(below), table.dead_s, **{key: getattr(table, key) for key in _NAMES})

    def __str__(self) -> str:
        """Return it as people write it."""
        top, bottom = _polynomial(self.numerator), _polynomial(self.denominator)
        dead = f" exp(-{self.dead_s:.4g} s)" if self.dead_s >= _SOME_S else ""
        return f"({top}){dead} / ({bottom})"


def _without_leading_zeros(coefficients: Sequence[float]) -> tuple[float, ...]:
    kept = [float(one) for one in coefficients]
    while len(kept) > 1 and kept[0] == 0.0:
        del kept[0]
    return tuple(kept) or (0.0,)


def _sorted(roots: NDArray[Any]) -> ComplexArray:
    found = np.asarray(roots, dtype=complex)
    return found[np.lexsort((found.imag, np.abs(found).round(12)))]


def _polynomial(coefficients: tuple[float, ...]) -> str:
    terms: list[str] = []
    for power, value in zip(range(len(coefficients) - 1, -1, -1), coefficients, strict=True):
        if value == 0.0 and len(coefficients) > 1:
            continue
        s = "" if power == 0 else " s" if power == 1 else f" s^{power}"
        sign = ("-" if value < 0 else "") if not terms else (" - " if value < 0 else " + ")
        number = "" if s and abs(value) == 1.0 else f"{abs(value):.4g}"
        terms.append(f"{sign}{(number + s).strip()}")
    return "".join(terms) or "0"
