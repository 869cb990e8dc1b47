"""What a model is: parameters, inputs, outputs, sites, and three compiled functions."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal, TypedDict

import numpy as np

from labrun.arrays import FloatArray
from labrun.compiled import NativeFunction, native
from labrun.effects import AttachedEffect, Site, SiteKind
from labrun.errors import ModelError
from labrun.toml import suggest

Between = Literal["linear", "hold", "band-limited"]
"""How an input runs between its samples."""
Condition = Mapping[str, float | str]


@dataclass(frozen=True, slots=True)
class Parameter:
    """A constant of a model.

    Attributes
    ----------
    value
        The best guess before any fit, in `unit`.
    tolerance
        Relative standard deviation of what is known beforehand; 0 = known exactly; "free" = not known.
    lower, upper
        Values beyond these make no sense.
    """

    name: str
    value: float
    tolerance: float | Literal["free"] = "free"
    unit: str = "1"
    lower: float = -np.inf
    upper: float = np.inf


@dataclass(frozen=True, slots=True)
class Input:
    """A signal that drives a model.

    Attributes
    ----------
    prescribed
        Whether it stands for what is known beside the model, as the motion of other joints, and is no site: nothing
        can be missing there.
    """

    name: str
    unit: str = "1"
    between: Between = "linear"
    prescribed: bool = False


@dataclass(frozen=True, slots=True)
class Output:
    """A signal a model gives.

    Attributes
    ----------
    followed
        Whether what was measured of it keeps the simulation on course, so that it is no site: what its sensor does is
        not to be told apart.
    shows
        Its equation, which may be no more than the name of a state; "" where it has none.
    """

    name: str
    unit: str = "1"
    followed: bool = False
    shows: str = ""


@dataclass(frozen=True, slots=True)
class Meaning:
    """What a condition means to equations where a trial says it in a word, or does not say it.

    Attributes
    ----------
    words : word -> number
    default
        A number or one of the words; None if every trial has to say it.
    of
        Name in the trial's condition, where it is not that in the equations: several numbers may follow from one word.
    """

    words: Mapping[str, float] = field(default_factory=dict)
    default: float | str | None = None
    of: str | None = None


@dataclass(frozen=True, slots=True)
class Origin:
    """Where a corrected model comes from.

    Attributes
    ----------
    model
        What `labrun.models.load_model` takes for the model that was corrected.
    data
        The run or recording it was corrected by; "" where the file does not say.
    """

    model: str
    data: str = ""


class Natives(TypedDict):
    """The compiled functions of a model, as `Model` takes them."""

    derivative: NativeFunction
    output: NativeFunction
    site_values: NativeFunction


def natives(
    derivative: Callable[..., None], output: Callable[..., None], site_values: Callable[..., None]
) -> Natives:
    """Return what `Model` takes for three module-level functions that numba compiles, see `Model` and `native`."""
    return {
        "derivative": native("model", derivative),
        "output": native("model", output),
        "site_values": native("model", site_values),
    }


@dataclass(frozen=True)
class Model:
    """A simulator: ``dx/dt = derivative(t, x, u, p, force)``, ``y = output(t, x, u, p, force)``.

    `p` is the parameters, then the conditions, then `constants`; `force` has one entry for each of `sites`.
    All functions have the signature ``(t, x, u, p, force, out)`` and are called through pointers to float64.

    Attributes
    ----------
    states, conditions
        Names. Conditions are numbers of a trial's condition that the equations use.
    sites
        The joint and body sites, in the order of `force`. See `places` for all sites.
    initial : state -> value
        A number, the name of a condition, that of an input (its first sample), "first" (mean of the first samples of
        that output) or "free".
    derivative, output
        The equations.
    site_values
        Writes coordinate, rate, load and stiffness of each of `sites` (4 values each, 0 where there is none).
    meanings : condition -> meaning
        Of those that trials may say in a word, or not at all.
    constants
        Further numbers the functions read behind the conditions, for example a table.
    source
        The file or object it comes from, for messages.
    notes
        What is odd about it, in sentences.
    effects
        Physics it carries at its sites; every simulation adds it before the effects it is given.
    origin
        Of a corrected model.
    """

    name: str
    states: tuple[str, ...]
    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    parameters: tuple[Parameter, ...]
    sites: tuple[Site, ...]
    initial: Mapping[str, float | str]
    derivative: NativeFunction
    output: NativeFunction
    site_values: NativeFunction
    conditions: tuple[str, ...] = ()
    meanings: Mapping[str, Meaning] = field(default_factory=dict)
    constants: FloatArray = field(default_factory=lambda: np.empty(0), compare=False)
    source: str = ""
    notes: tuple[str, ...] = ()
    effects: tuple[AttachedEffect, ...] = ()
    origin: Origin | None = None
    layouts: dict[Any, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Of `labrun.models.layout`, made once for each combination of effects; addresses, which do not travel."""

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "layouts": {}}

    @property
    def places(self) -> tuple[Site, ...]:
        """All sites: those that take a force, inputs that are not prescribed, outputs that are not followed."""
        inputs = [Site(signal.name, "input") for signal in self.inputs if not signal.prescribed]
        outputs = [Site(output.name, "output") for output in self.outputs if not output.followed]
        return (*self.sites, *inputs, *outputs)

    def site_named(self, name: str, kind: SiteKind | None = None) -> Site:
        """Return the site of that name (and kind); a force site goes before an input, an input before an output.

        Raises
        ------
        ModelError
            No such site, with the nearest one.
        """
        for site in self.places:
            if site.name == name and kind in (None, site.kind):
                return site
        known = {site.name for site in self.places if kind in (None, site.kind)}
        what = f"{kind} site" if kind else "site"
        raise ModelError(
            f"model {self.name} has no {what} {name!r}",
            hint=suggest(name, known) if known else f"it has no {what} at all",
        )

    def coordinate_unit(self, site: Site, measured: Mapping[str, str] = MappingProxyType({})) -> str:
        """Return the unit of the coordinate of a joint or body site.

        As the site says it; else as the signal of its name, or of its rate's, has it; else an output by another name
        that shows it, in rad or m; else from the unit of the site's stiffness ("N m/rad"). Where nothing tells, a joint
        turns and a body moves.

        Parameters
        ----------
        site
            One of `sites`.
        measured : name -> unit
            Of inputs and outputs as they were measured, where that is not what the model says.
        """
        units = {output.name: output.unit for output in self.outputs} | dict(measured)
        named = (units.get(name, "1").removesuffix("/s") for name in (site.coordinate, site.rate))
        shown = (units[output.name] for output in self.outputs if output.shows == site.coordinate)
        stiffness = next(
            (parameter.unit for parameter in self.parameters if parameter.name == site.stiffness), ""
        )
        sprung = [name for name in ("rad", "m") if stiffness.endswith(f"/{name}")]
        known = (site.unit, *named, *(unit for unit in shown if unit in ("rad", "m")), *sprung)
        return next((unit for unit in known if unit not in ("", "1")), "rad" if site.kind == "joint" else "m")

    @property
    def values(self) -> FloatArray:
        """Nominal parameter values, shape (parameters,)."""
        return np.array([parameter.value for parameter in self.parameters], dtype=float)

    @property
    def named_values(self) -> dict[str, float]:
        """Nominal parameter values by name."""
        return {parameter.name: float(parameter.value) for parameter in self.parameters}

    def vector(
        self, parameters: "FloatArray | Mapping[str, float] | None", condition: Condition
    ) -> FloatArray:
        """Return `p`: parameters (None = nominal; a mapping overrides some), conditions, constants.

        Raises
        ------
        ModelError
            An unknown parameter, or a condition that the equations use and this trial does not have as a number.
        """
        values = self.values
        if isinstance(parameters, Mapping):
            names = [parameter.name for parameter in self.parameters]
            for name, value in parameters.items():
                if name not in names:
                    raise ModelError(
                        f"model {self.name} has no parameter {name!r}", hint=suggest(name, names)
                    )
                values[names.index(name)] = value
        elif parameters is not None:
            if np.shape(parameters) != values.shape:
                raise ModelError(
                    f"model {self.name} has {len(values)} parameters; values of shape {np.shape(parameters)} were given"
                )
            values = np.asarray(parameters, dtype=float)
        numbers = [self._number(name, condition) for name in self.conditions]
        return np.concatenate([values, np.array(numbers, dtype=float), self.constants])

    def _number(self, name: str, condition: Condition) -> float:
        meaning = self.meanings.get(name, Meaning())
        quantity = meaning.of or name
        value = condition.get(quantity, meaning.default)
        if value is None:
            ours = [
                *self.states,
                *(signal.name for signal in self.inputs),
                *(parameter.name for parameter in self.parameters),
            ]
            raise ModelError(
                f"the equations of model {self.name} use {name!r}, which is not a state, input or parameter, "
                f"and the trial's condition has no {quantity!r} (it has: {', '.join(condition) or 'nothing'})",
                hint=suggest(quantity, [*ours, *condition]),
            )
        if isinstance(value, str) and value in meaning.words:
            return meaning.words[value]
        if isinstance(value, str) and meaning.words:
            raise ModelError(
                f"model {self.name} states no number for {quantity} = {value!r}",
                hint=f"{suggest(value, meaning.words)}; conditions.{name}.words states what each word means",
            )
        if isinstance(value, str):
            raise ModelError(
                f"the equations of model {self.name} use the condition {quantity!r} as a number; here it is {value!r}",
                hint="give it a number in the recording, or say in the model what the word means: "
                f"conditions.{name}.words = {{ {value} = NUMBER }}",
            )
        return float(value)

    def with_values(self, values: Mapping[str, float]) -> "Model":
        """Return the model with other nominal parameter values."""
        vector = self.vector(values, dict.fromkeys(self.conditions, 0.0))
        parameters = [
            dataclasses.replace(parameter, value=float(value))
            for parameter, value in zip(self.parameters, vector, strict=False)
        ]
        return dataclasses.replace(self, parameters=tuple(parameters))

    def with_effects(self, effects: Sequence[AttachedEffect]) -> "Model":
        """Return the model with these effects behind those it carries already.

        Raises
        ------
        ModelError
            An effect does not sit where it is put.
        """
        for effect in effects:
            effect.check(self)
        return dataclasses.replace(self, effects=(*self.effects, *effects))

    def with_initial(self, rules: Mapping[str, float | str]) -> "Model":
        """Return the model with other rules of how these states begin; see `initial`."""
        return dataclasses.replace(self, initial={**self.initial, **rules})

    def with_between(self, between: Mapping[str, Between]) -> "Model":
        """Return the model with its inputs running between samples as a recording says."""
        inputs = [
            dataclasses.replace(signal, between=between.get(signal.name, signal.between))
            for signal in self.inputs
        ]
        return dataclasses.replace(self, inputs=tuple(inputs))

    def initial_state(
        self,
        condition: Condition,
        *,
        first: Mapping[str, float] | None = None,
        free: Mapping[str, float] | None = None,
    ) -> FloatArray:
        """Return the state a trial begins in, shape (states,).

        Parameters
        ----------
        condition
            The trial's.
        first
            Mean of the first samples of each output, for states that begin with "first"; and of each input that states
            begin at, its first sample.
        free
            Values of the states that are "free"; those not given begin at `first` if it has them, else at 0.

        Raises
        ------
        ModelError
            A condition or a first value that is needed is not there.
        """
        first, free = first or {}, free or {}
        return np.array([self._start(state, condition, first, free) for state in self.states], dtype=float)

    def told_first(self, row: FloatArray) -> dict[str, float]:
        """Return the first sample of every input by name, as `initial_state` takes it."""
        return {signal.name: float(value) for signal, value in zip(self.inputs, row, strict=False)}

    def _start(
        self, state: str, condition: Condition, first: Mapping[str, float], free: Mapping[str, float]
    ) -> float:
        rule = self.initial.get(state, "free")
        if rule == "free":
            return free.get(state, first.get(state, 0.0))
        if rule == "first":
            if state not in first:
                raise ModelError(
                    f"state {state!r} of model {self.name} begins at the first samples of output {state!r}, "
                    "which are not there",
                    hint=f'give initial.{state} a number, a condition\'s name or "free"',
                )
            return first[state]
        if isinstance(rule, str) and rule in [signal.name for signal in self.inputs]:
            return first.get(rule, 0.0)
        if isinstance(rule, str):
            value = condition.get(rule)
            if value is None or isinstance(value, str):
                raise ModelError(
                    f"state {state!r} of model {self.name} begins at the condition {rule!r}; "
                    f"the trial has {'no such condition' if value is None else repr(value)}",
                    hint=f"its conditions: {', '.join(condition) or 'none'}",
                )
            return float(value)
        return float(rule)
