"""Effects: terms that a model may lack, with a few bounded parameters, at one kind of site."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from labrun.compiled import NativeFunction, native
from labrun.errors import ModelError
from labrun.toml import suggest

SiteKind = Literal["joint", "body", "base", "tip", "link", "controller", "input", "output"]
FORCED: frozenset[SiteKind] = frozenset({"joint", "body", "base", "tip", "link", "controller"})
"""Kinds of sites that take a force."""
Need = Literal["load", "stiffness", "drive"]

Quantity = Literal[
    "force",
    "load",
    "coordinate",
    "rate",
    "damping",
    "drag",
    "stiffness",
    "cubic-stiffness",
    "inertia",
    "compliance",
    "signal",
    "signal-rate",
    "time",
    "acceleration-time",
    "time-per-coordinate",
    "per-coordinate",
    "ratio",
]

_FORCES = {"rad": "N m", "m": "N"}
"""Generalized forces by the unit of the coordinate; of any other, the force is what the model's equation says."""
_QUOTED = '"..."'
_INERTIAS = {"rad": "kg m^2", "m": "kg"}


@dataclass(frozen=True, slots=True)
class Scale:
    """Typical magnitudes at a site: peak excursion, speed, acceleration and force of the data, SI.

    The default 1 everywhere leaves an effect's numbers as they stand. `inertia` is what moves already: a free axis
    goes far in a long trial by a force that would hardly accelerate it. It also comes round slowly, however fast it is
    shaken: `acceleration_time_s` is the period in which accelerations come and go (0: as `time_s`). `travel` is half
    the way from end to end (0: as far as the peak excursion). `load` is the peak of what the site carries, or of what
    its drive asks for: a heavy axis takes more of it than what would keep it at its speed.
    """

    coordinate: float = 1.0
    rate: float = 1.0
    acceleration: float = 1.0
    force: float = 1.0
    signal: float = 1.0
    time_s: float = 1.0
    inertia: float = 0.0
    travel: float = 0.0
    acceleration_time_s: float = 0.0
    load: float = 0.0

    def of(self, quantity: Quantity) -> float:
        """Return the typical magnitude of a quantity, SI."""
        return {
            "force": self.force,
            "load": max(self.force, self.load),
            "coordinate": self.coordinate,
            "rate": self.rate,
            "damping": self.force / self.rate,
            "drag": self.force / self.rate**2,
            "stiffness": self.force / self.coordinate,
            "cubic-stiffness": self.force / self.coordinate**3,
            "inertia": max(self.force / self.acceleration, self.inertia),
            "compliance": self.force / self.coordinate,  # a link's site has as coordinate what it multiplies
            "signal": self.signal,
            "signal-rate": self.signal / self.time_s,
            "time": self.time_s,
            "acceleration-time": self.acceleration_time_s or self.time_s,
            "time-per-coordinate": 1.0 / self.rate,
            "per-coordinate": 1.0 / (self.travel or self.coordinate),
            "ratio": 1.0,
        }[quantity]


def unit_of(quantity: Quantity, coordinate_unit: str = "rad", signal_unit: str = "1") -> str:
    """Return the unit of a quantity at a site whose coordinate (or whose signal) has that unit."""
    c = coordinate_unit
    force = _FORCES.get(c, "force")
    units: dict[Quantity, str] = {
        "time": "s",
        "acceleration-time": "s",
        "ratio": "1",
        "signal": signal_unit,
        "signal-rate": f"{signal_unit}/s",
        "coordinate": c,
        "rate": f"{c}/s",
        "time-per-coordinate": f"s/{c}",
        "per-coordinate": f"1/{c}",
        "force": force,
        "load": force,
        "damping": f"{force} s/{c}",
        "drag": f"{force} s^2/{c}^2",
        "stiffness": f"{force}/{c}",
        "cubic-stiffness": f"{force}/{c}^3",
        "inertia": _INERTIAS.get(c, f"force s^2/{c}"),
        "compliance": f"{c}/({force})" if " " in force else f"{c}/{force}",
    }
    return units[quantity]


@dataclass(frozen=True, slots=True)
class Site:
    """A place of a model where physics can be missing.

    Attributes
    ----------
    kind
        ``joint``, ``body``, ``base``, ``tip``, ``link`` and ``controller`` sites take forces; every input and every
        output is a site of its own kind.
    coordinate, rate
        Expressions of a joint's or body's coordinate and of its time derivative. Of a robot's base: what gravity asks
        of a joint for each rad that the base is rolled, and pitched; of its tip: what a joint must exert for each
        kilogram there; of its link: what its drive exerts less for each rad (m) that it gives way by each N m (N); of
        its controller: what holds a joint against gravity, and what moves it as it moves, gravity included.
    load
        Expression of the load the joint carries; "" where a model gives none.
    stiffness
        Name of the parameter that is the site's own spring, or an expression where a condition exchanges it; "" where
        there is none.
    drive
        Whether the load is what the joint's own drive puts on it, through its gear.
    unit
        Of the coordinate, ``rad`` or ``m``; "" where nobody said it.
    """

    name: str
    kind: SiteKind
    coordinate: str = ""
    rate: str = ""
    load: str = ""
    stiffness: str = ""
    drive: bool = False
    unit: str = ""


class HasSites(Protocol):
    """A model, as far as an effect has to know it: see `labrun.models.Model`."""

    @property
    def name(self) -> str:
        """For messages."""

    @property
    def inputs(self) -> Sequence[object]:
        """One for each signal that drives it."""

    @property
    def outputs(self) -> Sequence[object]:
        """One for each signal it gives."""

    def site_named(self, name: str, kind: SiteKind | None = None, /) -> Site:
        """Return the site of that name and kind."""


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """A parameter of an effect. Its numbers are multiples of what is typical at the site (see `Scale`).

    Attributes
    ----------
    quantity
        What it measures, from which its unit and its typical magnitude follow.
    neutral
        The value at which the effect vanishes; None for a shape parameter, which vanishes with the others.
    lower, upper
        Bounds for a search; `neutral` may lie beyond them (infinity for a level that is never reached).
    starts
        Values to start a fit from.
    held
        Not estimated: stays at its first start (a regularisation speed). With further starts it is a shape, which is
        estimated too where the effect explains much and its usual shape does not do.
    instead_of
        Of a shape: the other shape in whose place it is estimated, never beside it.
    """

    name: str
    quantity: Quantity
    neutral: float | None
    lower: float
    upper: float
    starts: tuple[float, ...]
    held: bool = False
    instead_of: str = ""

    @property
    def shape(self) -> bool:
        """Tell whether it is held, but may be fitted after all."""
        return self.held and len(self.starts) > 1

    def bounds(self, scale: Scale) -> tuple[float, float]:
        """Return the bounds at a site, SI."""
        typical = scale.of(self.quantity)
        return self.lower * typical, self.upper * typical

    def start_values(self, scale: Scale) -> tuple[float, ...]:
        """Return the starts at a site, SI."""
        return tuple(start * scale.of(self.quantity) for start in self.starts)

    def unit(self, coordinate_unit: str = "rad", signal_unit: str = "1") -> str:
        """Return the unit it has at a site with a coordinate (or a signal) of that unit."""
        return unit_of(self.quantity, coordinate_unit, signal_unit)


@dataclass(frozen=True)
class Effect:
    """A kind of missing physics.

    Attributes
    ----------
    id
        Its fixed name.
    kind
        The kind of site it belongs to. Effects of different kinds may share an id (``delay``).
    function
        The compiled force law (joint, body) or filter (input, output); see `labrun.compiled.Signature`.
    form
        Its equations.
    source
        Where the form comes from.
    states
        Internal states of a force law, integrated with the model's.
    memory
        Numbers a filter keeps: given its values and the shortest step in s.
    ahead
        Of a filter: the parameter that says how much later the signal is to be read. Where its whole course
        is known that is done exactly; `function` is what a bench that goes step by step does instead.
    needs
        What a site must declare for it; `unless` what makes it needless there.
    stand_ins
        Ids of the effects that do the same where a site does not declare what it needs: there it is not missed.
    needs_acceleration
        Whether the force depends on the site's acceleration, linearly. The integrator then solves for both.
    signals
        Of a filter: how many signals of its kind the model must have, itself included.
    caution
        What to know wherever it is named; empty if nothing.
    compound
        Whether simpler effects together look nearly the same: where they explain as much, they are preferred.
    least_travel
        How far a site has to move for it to be more than simpler effects, SI: half a turn, say.
    title
        What it is, in a sentence.
    origin
        The TOML file it was read from, as it was named; "" for those that ship and those written in Python.
    contains
        Ids of simpler effects that it becomes at some sizes. A library without one of them is without this one, too.
    arguments
        What of the site or of the signals its equations use; empty for those written in Python.
    """

    id: str
    kind: SiteKind
    parameters: tuple[EffectParameter, ...]
    function: NativeFunction
    form: str
    source: str
    states: int = 0
    memory: Callable[[Sequence[float], float], int] | None = None
    ahead: str = ""
    needs: tuple[Need, ...] = ()
    unless: tuple[Need, ...] = ()
    stand_ins: tuple[str, ...] = ()
    needs_acceleration: bool = False
    signals: int = 1
    contains: tuple[str, ...] = ()
    caution: str = ""
    compound: bool = False
    least_travel: float = 0.0
    title: str = ""
    origin: str = ""
    arguments: frozenset[str] = frozenset()

    @property
    def periodic(self) -> bool:
        """Tell whether it comes back along the coordinate: `periods`, with the sizes of its `sine` and its `cosine`."""
        return {"periods", "sine", "cosine"} == {parameter.name for parameter in self.parameters}

    def fits(self, site: Site, scale: Scale | None = None) -> bool:
        """Tell whether to look for it at a site: of its kind, with what it needs, without what replaces it.

        Parameters
        ----------
        scale
            Of the site in the data, which may be too small for it; not asked if None.
        """
        if scale is not None and 2.0 * (scale.travel or scale.coordinate) < self.least_travel:
            return False
        declared = all(getattr(site, need) for need in self.needs)
        return site.kind == self.kind and declared and not any(getattr(site, need) for need in self.unless)

    def attach(self, site: str, scale: Scale | None = None, /, **values: float) -> "AttachedEffect":
        """Put it at a site with these values (SI); those not given take their first start.

        Raises
        ------
        ModelError
            A value it has no parameter for.
        """
        names = [parameter.name for parameter in self.parameters]
        for name in values:
            if name not in names:
                raise ModelError(f"effect {self.id} has no parameter {name!r}", hint=suggest(name, names))
        defaults = {
            parameter.name: parameter.start_values(scale or Scale())[0] for parameter in self.parameters
        }
        return AttachedEffect(self, site, tuple(float({**defaults, **values}[name]) for name in names))


@dataclass(frozen=True)
class AttachedEffect:
    """An effect at a site, with its values (SI) in the order of its parameters."""

    effect: Effect
    site: str
    values: tuple[float, ...]

    @property
    def named_values(self) -> Mapping[str, float]:
        """The values by name, without shapes that stand in for another one but do not (they are 0)."""
        pairs = zip(self.effect.parameters, self.values, strict=True)
        return {
            parameter.name: value for parameter, value in pairs if value != 0.0 or not parameter.instead_of
        }

    def with_values(self, values: Sequence[float]) -> "AttachedEffect":
        """Return the same with other values."""
        return AttachedEffect(self.effect, self.site, tuple(float(value) for value in values))

    def check(self, model: HasSites) -> Site:
        """Return the site it sits at.

        Raises
        ------
        ModelError
            The model has no such site, the site lacks what the effect needs, or a value is missing or not a number.
        """
        site = model.site_named(self.site, self.effect.kind)
        for need in self.effect.needs:
            if not getattr(site, need):
                raise ModelError(
                    f"effect {self.effect.id} needs the {need} at site {site.name}, "
                    f"which model {model.name} does not give",
                    hint=f"add {need} = {'true' if need == 'drive' else _QUOTED} to [sites.{site.name}]",
                )
        there = {"input": len(model.inputs), "output": len(model.outputs)}.get(self.effect.kind, 1)
        if there < self.effect.signals:
            raise ModelError(
                f"effect {self.effect.id} at {site.name} needs {self.effect.signals} {self.effect.kind}s; "
                f"model {model.name} has {there}"
            )
        if len(self.values) != len(self.effect.parameters):
            names = ", ".join(parameter.name for parameter in self.effect.parameters)
            raise ModelError(f"effect {self.effect.id} takes {names}; {len(self.values)} values were given")
        for name, value in self.named_values.items():
            if math.isnan(value):
                raise ModelError(f"effect {self.effect.id} at {site.name}: {name} is not a number")
        return site


def force_law(law: Callable[..., Any]) -> NativeFunction:
    """Wrap ``law(t, q, rate, acceleration, load, stiffness, values, z, dz) -> force`` for an `Effect`.

    `q`, `rate`, `acceleration`, `load` and `stiffness` are the site's; `values` the effect's parameters. A law with
    internal states reads `z` and writes their derivatives to `dz`.
    """
    return native("law", law)


def signal_filter(step: Callable[..., Any]) -> NativeFunction:
    """Wrap ``step(before, after, dt, values, memory, out)`` for an `Effect`.

    It is called for each piece of the signal in turn, in which the signal goes straight from ``before[0]`` to
    ``after[0]`` in `dt` seconds, and writes what it makes of both ends to ``out[0]`` and ``out[1]`` (two values, so
    that jumps between pieces stay jumps). A filter whose answer is not straight in between may write to ``out[2]`` by
    how much its mean over the piece exceeds that of the straight line: of an input, the model then sees the right
    mean. ``before[1]``, ``after[1]`` ... are the other signals of the same kind, in the order of the model. The first
    call has ``dt = 0``: the signal has always had this value; the memory then holds
    zeros but for ``memory[0]``, which is its length.
    """
    return native("filter", step)
