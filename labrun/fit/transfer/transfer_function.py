"""A transfer function with a dead time: its exact answers, what a controller is designed on, and its TOML.

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
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from labrun.arrays import FloatArray
from labrun.control import TransferTable, response_table
from labrun.errors import RequestError
from labrun.toml import Places, parsed, refusal, validate

Hold = Literal["linear", "constant"]
_WHOLE = 1e-9
"""A dead time this close to a whole number of samples is one."""


def powers(
    denominator: tuple[float, ...],
    dead_s: float,
    step_s: float,
    values: FloatArray,
    hold: Hold = "linear",
    before: float = 0.0,
) -> FloatArray:
    """Return the answers of ``s^k exp(-dead_s s) / denominator(s)``, k from 0 to its order, shape (n, order + 1).

    Any numerator's answer is their sum, weighted by its coefficients, lowest power first. The state moves from sample
    to sample by a matrix exponential, without any error of integration (Van Loan 1978, *IEEE Trans. Autom. Control*
    23:395). The dead time need not be a whole number of samples: the output between two samples follows from the state
    at the earlier one by the exponential of the part step.
    """
    system = StateSpace((1.0,), denominator, step_s)
    whole = int(np.ceil(dead_s / step_s - _WHOLE))
    part_s = whole * step_s - dead_s
    following = values[1:] if hold == "linear" else values[:-1]
    early = system.steady(before)
    states = system.states(values, following, early)
    count = max(len(values) - whole, 0)
    after = np.append(following, values[-1])[:count]
    late, held = system.later(
        states[:count], values[:count], after, part_s if part_s > _WHOLE * step_s else 0.0
    )
    answers = np.tile(system.derivatives(early[None], np.array([before])), (len(values), 1))
    answers[whole:] = system.derivatives(late, held)
    return answers


def free_answers(denominator: tuple[float, ...], step_s: float, count: int) -> FloatArray:
    """Return a basis of what the system does by itself from any initial state, (count, order)."""
    system = StateSpace((1.0,), denominator, step_s)
    return system.states(np.zeros(count), np.zeros(count - 1), system.b)


class StateSpace:
    """Controller canonical form with time in units of its own speed, so that its matrix is well scaled."""

    def __init__(self, numerator: tuple[float, ...], denominator: tuple[float, ...], step_s: float) -> None:
        size = len(denominator) - 1
        lead = denominator[0]
        below = np.array(denominator[1:]) / lead
        above = np.concatenate([np.zeros(size + 1 - len(numerator)), numerator]) / lead
        self.size = size
        self.step_s = step_s
        self.through = float(above[0])
        self.lead = lead
        # each state in units of speed^k: the companion matrix of poles near the unit circle
        powers = np.arange(1.0, size + 1)
        speed = float(np.max(np.abs(below) ** (1.0 / powers))) if size and np.any(below) else 1.0
        self.a = np.zeros((size, size))
        self.b = np.zeros(size)
        self.c = np.zeros(size)
        if size:
            self.a[0] = -below / speed ** (powers - 1)
            self.a[range(1, size), range(size - 1)] = speed
            self.b[0] = speed
            self.c = (above[1:] - below * self.through) / speed**powers
        self.speeds = speed**powers

    def derivatives(self, states: FloatArray, values: FloatArray) -> FloatArray:
        """Return the answers of s^k/denominator, k rising from 0, of states and input at the same times."""
        # the first state's rate, in its own units, is the answer of s^n
        highest = (states @ self.a[0] + self.b[0] * values) / self.b[0] if self.size else values
        return np.column_stack([(states / self.speeds)[:, ::-1], highest]) / self.lead

    def steady(self, value: float) -> FloatArray:
        """Return the state that a constant input has led to."""
        if value == 0.0 or self.size == 0:
            return np.zeros(self.size)
        try:
            return np.asarray(np.linalg.solve(self.a, -self.b * value))
        except np.linalg.LinAlgError:
            raise RequestError(
                "a transfer function with a pole at zero has no steady state under a constant input",
                hint="start it from input 0",
            ) from None

    def matrices(self, step_s: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the state's move over a step: by itself, by the input, by how much the input grows over it."""
        from scipy.linalg import expm

        size = self.size
        augmented = np.zeros((size + 2, size + 2))
        augmented[:size, :size], augmented[:size, size] = self.a * step_s, self.b * step_s
        augmented[size, size + 1] = 1.0
        moved = expm(augmented)
        return moved[:size, :size], moved[:size, size], moved[:size, size + 1]

    def states(self, values: FloatArray, following: FloatArray, start: FloatArray) -> FloatArray:
        """Return the state at every sample, (n, size).

        The recursion runs in the basis of a Schur form, where each state is a filter of first order on those after it:
        as exact with equal poles as with different ones.
        """
        from scipy.linalg import schur
        from scipy.signal import lfilter

        if self.size == 0:
            return np.zeros((len(values), 0))
        move, by_input, by_growth = self.matrices(self.step_s)
        triangle, basis = schur(move, output="complex")
        drive = np.outer(values[:-1], by_input) + np.outer(following - values[:-1], by_growth)
        turned = drive @ basis.conj()
        first = basis.conj().T @ start
        result = np.empty((len(values), self.size), dtype=complex)
        for row in range(self.size - 1, -1, -1):
            pushed = turned[:, row] + result[:-1, row + 1 :] @ triangle[row, row + 1 :]
            pole = triangle[row, row]
            result[0, row] = first[row]
            result[1:, row] = lfilter([1.0], [1.0, -pole], pushed, zi=[pole * first[row]])[0]
        return np.asarray((result @ basis.T).real)

    def later(
        self, states: FloatArray, values: FloatArray, following: FloatArray, part_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """Return state and input `part_s` after each sample."""
        growth = (following - values) * (part_s / self.step_s)
        if not self.size:
            return states, values + growth
        move, by_input, by_growth = self.matrices(part_s)
        return states @ move.T + np.outer(values, by_input) + np.outer(growth, by_growth), values + growth


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
            _without_leading_zeros(coefficients) for coefficients in (self.numerator, self.denominator)
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
        changed = {"numerator": numerator, "denominator": denominator, "dead_s": float(self.dead_s)}
        for name, value in changed.items():
            object.__setattr__(self, name, value)

    @classmethod
    def first_order(cls, gain: float, lag_s: float, dead_s: float = 0.0, **names: str) -> "TransferFunction":
        """Return ``gain exp(-dead_s s) / (lag_s s + 1)``; `names` are names and units as of the class."""
        return cls((gain,), (lag_s, 1.0), dead_s, **names)

    @property
    def gain(self) -> float:
        """Static gain, output_unit/input_unit; infinite with a pole at zero."""
        return self.numerator[-1] / self.denominator[-1] if self.denominator[-1] else float("inf")

    @property
    def gain_unit(self) -> str:
        """Unit of the gain."""
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

        names = {"inputs": self.input_name, "outputs": self.output_name}
        named = {key: value for key, value in names.items() if value and "." not in value}
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
        from scipy.linalg import expm

        system = StateSpace(self.numerator, self.denominator, 1.0)
        after_s, size = np.asarray(time_s, dtype=float) - self.dead_s, system.size
        augmented = np.zeros((size + 1, size + 1))
        augmented[:size, :size], augmented[:size, size] = system.a, system.b
        moved = expm(augmented * np.atleast_1d(np.maximum(after_s, 0.0))[..., None, None])
        values = (moved[..., :size, size] @ system.c + system.through).reshape(after_s.shape)
        return np.where(after_s >= 0.0, values, 0.0)

    def to_table(self) -> dict[str, Any]:
        """Return it as the keys of a TOML table."""
        table: dict[str, Any] = (
            {"gain": self.gain, "lag_s": self.lag_s}
            if self.is_first_order
            else {"numerator": list(self.numerator), "denominator": list(self.denominator)}
        )
        names = {key: getattr(self, key) for key in _NAMES if getattr(self, key)}
        return {**table, "dead_s": self.dead_s, **names}

    @classmethod
    def from_toml(
        cls, text: str, response: str | None = None, *, name: str = "transfer function"
    ) -> "TransferFunction":
        """Read one of a TOML text: its keys at the top, or in a table for each response, as the fits write them.

        `response` says which table, where there are several. `name`: of the file, for messages.

        Raises
        ------
        RequestError
            Not TOML, no such response, a key that is missing, unknown or of the wrong kind; with line and column.
        """
        data = parsed(text, name)
        table, path = response_table(data, name, response)
        stated = {key: value for key, value in table.items() if not key.endswith(_INTERVAL)}
        keys, faults = validate(NamedTransferTable, stated, path)
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
    kept = [float(coefficient) for coefficient in coefficients]
    while len(kept) > 1 and kept[0] == 0.0:
        del kept[0]
    return tuple(kept) or (0.0,)


def _sorted(roots: NDArray[Any]) -> ComplexArray:
    complex_roots = np.asarray(roots, dtype=complex)
    return complex_roots[np.lexsort((complex_roots.imag, np.abs(complex_roots).round(12)))]


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
