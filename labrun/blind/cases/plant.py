"""A bench: equations twice (as text for the model file, as numpy here), parameters, sites and a programme of trials."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Between = Literal["linear", "hold"]
_Item = TypeVar("_Item")
Values = Mapping[str, FloatArray]
"""Parameters and the numbers of conditions: one value per trial each, shape (trials,)."""
Condition = dict[str, float | str]


@dataclass(frozen=True)
class Parameter:
    """A constant of the bench, with what the person at the bench knows of it."""

    name: str
    true: float
    tolerance: float | Literal["free"]
    unit: str


@dataclass(frozen=True)
class Signal:
    """An input or an output; `equation` is an output's, as the model file has it."""

    name: str
    unit: str
    between: Between = "linear"
    equation: str = ""


@dataclass(frozen=True)
class Site:
    """A joint or a body, as the model file describes it.

    Attributes
    ----------
    effects
        Physics of the library that may be hidden here without two others being exactly equal to it.
    """

    name: str
    kind: Literal["joint", "body"]
    coordinate: str
    rate: str
    stiffness: str = ""
    load: str = ""
    effects: tuple[str, ...] = ()


@dataclass(frozen=True)
class At:
    """Where a site is at one instant, each of shape (trials,)."""

    coordinate: FloatArray
    rate: FloatArray
    load: FloatArray
    stiffness: FloatArray


@dataclass
class Programme:
    """Trials: conditions, and the inputs that go with them.

    Attributes
    ----------
    time_s : (samples,)
        The same for all trials, evenly spaced from zero.
    inputs : (inputs, samples, trials)
    """

    time_s: FloatArray
    conditions: list[Condition]
    inputs: FloatArray

    def take(self, which: Sequence[int]) -> "Programme":
        """Return some of the trials, possibly more than once."""
        index = list(which)
        return Programme(
            self.time_s, [self.conditions[one] for one in index], self.inputs[:, :, index].copy()
        )


@dataclass
class Plant(ABC):
    """One bench, drawn at random within what such a bench may be.

    Subclasses add `rates`, `read`, `at` and `programme`.

    Attributes
    ----------
    initial
        As in the model file: a number, the name of a condition, "first" or "free".
    input_effects, output_effects
        By signal, which of the library's effects may be hidden there.
    returns
        Whether it moves to and fro, and not ever on.
    """

    name: str = ""
    states: tuple[str, ...] = ()
    inputs: tuple[Signal, ...] = ()
    outputs: tuple[Signal, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    equations: dict[str, str] = field(default_factory=dict)
    sites: tuple[Site, ...] = ()
    initial: dict[str, float | str] = field(default_factory=dict)
    conditions: tuple[str, ...] = ()
    input_effects: dict[str, tuple[str, ...]] = field(default_factory=dict)
    output_effects: dict[str, tuple[str, ...]] = field(default_factory=dict)
    returns: bool = True

    @abstractmethod
    def rates(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        """Return the derivatives of the states (states, trials)."""

    @abstractmethod
    def read(self, t: float, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        """Return the outputs (outputs, trials)."""

    @abstractmethod
    def at(self, site: str, x: FloatArray, u: FloatArray, p: Values) -> At:
        """Return where a site is."""

    @abstractmethod
    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        """Return so many trials of different conditions."""

    def start(self, conditions: Sequence[Mapping[str, float | str]]) -> FloatArray:
        """Return the true initial states (states, trials); what the model file calls "first" or "free" included."""
        start = np.zeros((len(self.states), len(conditions)))
        for row, state in enumerate(self.states):
            rule = self.initial[state]
            if isinstance(rule, str) and rule not in ("first", "free"):
                start[row] = [one[rule] for one in conditions]
            elif not isinstance(rule, str):
                start[row] = rule
        return start

    def rate_row(self, site: str) -> int | None:
        """Return which state is a site's rate; None where no state is."""
        rate = next(one.rate for one in self.sites if one.name == site)
        return self.states.index(rate) if rate in self.states else None

    def values(
        self, conditions: Sequence[Mapping[str, float | str]], parameters: Mapping[str, FloatArray | float]
    ) -> dict[str, FloatArray]:
        """Return `p` for trials of these conditions."""
        trials = len(conditions)
        p = {
            name: np.broadcast_to(np.asarray(value, dtype=float), (trials,))
            for name, value in parameters.items()
        }
        for name in self.conditions:
            p[name] = np.array([one[name] for one in conditions], dtype=float)
        return p

    @property
    def truth(self) -> dict[str, float]:
        """The true parameters."""
        return {one.name: one.true for one in self.parameters}


def only_if(holds: bool, *items: _Item) -> tuple[_Item, ...]:
    """Return the items, or none of them."""
    return items if holds else ()


def near(rng: np.random.Generator, value: float, factor: float = 1.3) -> float:
    """Return a value up to a factor away, to four digits."""
    return float(f"{value * factor ** rng.uniform(-1, 1):.4g}")


def draw_between(rng: np.random.Generator) -> Between:
    """Return how an input runs between its samples."""
    return "hold" if rng.random() < 0.4 else "linear"
