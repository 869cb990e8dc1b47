"""A bench: equations as the model file has them, parameters, sites, its trials, and physics to hide in it."""

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Between = Literal["linear", "hold"]
_Item = TypeVar("_Item")
Values = Mapping[str, FloatArray]
"""Parameters and the numbers of conditions: one value per trial each, shape (trials,)."""
Condition = dict[str, float | str]
_NAME = re.compile(r"(?<![\w.])[A-Za-z_][\w.]*")

YIELDING = (
    "coulomb-friction",
    "stribeck-friction",
    "presliding-friction",
    "cubic-stiffness",
    "asymmetric-friction",
    "asymmetric-stiffness",
    "viscoelastic-creep",
    "hysteresis",
    "end-stop",
)
JOINT = (*YIELDING, "quadratic-drag", "cogging")
DRIVEN = ("delay", "lag", "saturation", "rate-limit", "dead-band")
READ = ("lag", "delay", "drift", "saturation")
ALL_READ = (*READ, "bias", "gain-error", "cross-talk")
"""Effects of the library that most joints, inputs and outputs may have; an order that seeds rely on."""


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
    spring
        The spring that is there all the same where the model file names no stiffness.
    effects
        Physics of the library that may be hidden here without two others being exactly equal to it.
    """

    name: str
    kind: Literal["joint", "body"]
    coordinate: str
    rate: str
    stiffness: str = ""
    load: str = ""
    spring: str = ""
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
            self.time_s, [self.conditions[row] for row in index], self.inputs[:, :, index].copy()
        )


@dataclass
class Plant(ABC):
    """One bench, drawn at random within what such a bench may be.

    Subclasses say all of it, and add `programme`.

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

    def __post_init__(self) -> None:
        self._rates = self._function([self.equations[state] for state in self.states])
        self._read = self._function([output.equation for output in self.outputs])
        self._at = {
            site.name: self._function([site.coordinate, site.rate, site.load, site.stiffness or site.spring])
            for site in self.sites
        }

    def _function(self, equations: Sequence[str]) -> Callable[..., FloatArray]:
        """Return equations of the model file as one function of numpy arrays; an empty one is 0."""
        places = {name: f"x[{row}]" for row, name in enumerate(self.states)}
        places |= {signal.name: f"u[{row}]" for row, signal in enumerate(self.inputs)}
        places |= {
            name: f"p['{name}']"
            for name in (*(parameter.name for parameter in self.parameters), *self.conditions)
        }
        places |= {f"force.{site.name}": f"force['{site.name}']" for site in self.sites}
        places |= {name: f"np.{name}" for name in ("sin", "cos", "abs")}
        rows = [
            _NAME.sub(lambda match: places[match.group()], text).replace("^", "**") if text else "nothing"
            for text in equations
        ]
        # our own texts, with our own names put in
        return cast(
            "Callable[..., FloatArray]",
            eval(f"lambda x, u, p, force, nothing: np.array([{', '.join(rows)}])"),
        )

    def rates(self, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        """Return the derivatives of the states (states, trials)."""
        return self._rates(x, u, p, force, None) if self.states else np.zeros((0, x.shape[1]))

    def read(self, x: FloatArray, u: FloatArray, p: Values, force: Values) -> FloatArray:
        """Return the outputs (outputs, trials)."""
        return self._read(x, u, p, force, None)

    def at(self, site: str, x: FloatArray, u: FloatArray, p: Values) -> At:
        """Return where a site is."""
        return At(*self._at[site](x, u, p, None, np.zeros(x.shape[1])))

    @abstractmethod
    def programme(self, rng: np.random.Generator, trials: int) -> Programme:
        """Return so many trials of different conditions."""

    def start(self, conditions: Sequence[Mapping[str, float | str]]) -> FloatArray:
        """Return the true initial states (states, trials); what the model file calls "first" or "free" included."""
        start = np.zeros((len(self.states), len(conditions)))
        for row, state in enumerate(self.states):
            rule = self.initial[state]
            if isinstance(rule, str) and rule not in ("first", "free"):
                start[row] = [condition[rule] for condition in conditions]
            elif not isinstance(rule, str):
                start[row] = rule
        return start

    def rate_row(self, site: str) -> int | None:
        """Return which state is a site's rate; None where no state is."""
        rate = next(state.rate for state in self.sites if state.name == site)
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
            p[name] = np.array([condition[name] for condition in conditions], dtype=float)
        return p

    @property
    def truth(self) -> dict[str, float]:
        """The true parameters."""
        return {parameter.name: parameter.true for parameter in self.parameters}


def damping_of(
    rng: np.random.Generator, name: str, shares: tuple[float, float], stiffness_inertia: float
) -> Parameter:
    """Return the damping of a joint: a drawn share of sqrt(stiffness * inertia), left to the fit."""
    value = four_digits(rng.uniform(*shares) * np.sqrt(stiffness_inertia))
    return Parameter(name, value, "free", "N m s/rad")


def only_if(holds: bool, *items: _Item) -> tuple[_Item, ...]:
    """Return the items, or none of them."""
    return items if holds else ()


def near(rng: np.random.Generator, value: float, factor: float = 1.3) -> float:
    """Return a value up to a factor away, to four digits."""
    return four_digits(value * factor ** rng.uniform(-1, 1))


def four_digits(value: float) -> float:
    """Return a value as a person would state it."""
    return float(f"{value:.4g}")


def draw_between(rng: np.random.Generator) -> Between:
    """Return how an input runs between its samples."""
    return "hold" if rng.random() < 0.4 else "linear"


Kind = Literal["joint", "body", "input", "output"]


@dataclass(frozen=True)
class Measures:
    """How large things are at a site, or how a signal runs, without anything hidden.

    Attributes
    ----------
    q, v, top
        Peak coordinate and speed of all but the largest half percent, and the largest coordinate of all (of a signal:
        the same of it and its rate).
    a
        Acceleration, root mean square.
    force
        A typical generalized force: of a joint its inertia times acceleration, root mean square.
    stiffness
        Force per coordinate; the site's own spring where it has one.
    other
        Peak of the next signal of the same kind; at a joint, of its load.
    row
        Which of the signals of its kind it is.
    """

    q: float
    v: float
    a: float
    force: float
    stiffness: float
    step_s: float
    length_s: float
    period_s: float
    other: float = 0.0
    row: int = 0
    top: float = 0.0


@dataclass(frozen=True)
class Mechanism:
    """One piece of physics at one site, its size still open.

    Attributes
    ----------
    effect
        The library's id for it; "" for physics that the library does not have.
    form
        What its equations really are.
    law
        ``law(size, t, z, at) -> (force, dz)`` at joints and bodies; at inputs and outputs
        ``law(size, t, z, now, signals) -> (signal, dz)``, `signals` being all of the same kind. z and dz have the shape
        (states, trials); a law without states takes and returns none.
    mass
        ``mass(size, at) -> (trials,)``: force in proportion to minus the acceleration, on top of `law`.
    shift_s
        ``shift_s(size)``: seconds by which a signal is late before `law` sees it.
    prepare
        ``prepare(size, step_s, signal) -> signal``: an input worked out beforehand on a fine grid (samples, trials),
        where an equation would be too stiff; `law` then sees the result.
    start, most
        Where a search for the size begins, and where it must end.
    fastest
        ``fastest(size)``: the fastest rate in it, 1/s, for choosing a step.
    values
        ``values(size)``: the true values, under the library's names where it has them.
    jumps_s
        Times at which it changes abruptly.
    """

    effect: str
    site: str
    kind: Kind
    form: str
    law: Callable[..., Any]
    values: Callable[[float], Mapping[str, float]]
    start: float = 0.1
    most: float = 1.0
    states: int = 0
    mass: Callable[[float, At], FloatArray] | None = None
    shift_s: Callable[[float], float] | None = None
    prepare: Callable[[float, float, FloatArray], FloatArray] | None = None
    fastest: Callable[[float], float] = lambda _size: 0.0
    jumps_s: tuple[float, ...] = field(default=())
    rough: bool = False


@dataclass(frozen=True)
class Hidden:
    """A mechanism of a certain size."""

    mechanism: Mechanism
    size: float

    def apply(self, t: float, z: FloatArray, *seen: Any) -> tuple[FloatArray, FloatArray | float]:
        """Return its force or signal at what it sees, and the derivative of its states."""
        law = self.mechanism.law
        return law(self.size, t, z, *seen) if self.mechanism.states else (law(self.size, t, *seen), 0.0)
