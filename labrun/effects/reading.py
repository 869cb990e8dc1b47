"""Read effects from TOML files and entry points."""

import functools
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import Any, get_args

from pydantic import ConfigDict, Field

from labrun import registry
from labrun.compiled import NativeFunction, law, native, signal_step
from labrun.effects.effect import FORCED, Effect, EffectParameter, Need, Quantity, SiteKind
from labrun.errors import ModelError, PluginError
from labrun.toml import Expression, Fault, Places, Table, parsed, refusal, suggest, text_of, validate

_SITE = ("t", "q", "rate", "acceleration", "load", "stiffness")
_SIGNAL = ("t", "signal", "other")


class _Parameter(Table):
    """A parameter of an effect; as `EffectParameter`."""

    model_config = ConfigDict(allow_inf_nan=True)

    quantity: Quantity
    neutral: float | None = None
    lower: float
    upper: float
    starts: tuple[float, ...] = Field(min_length=1)
    held: bool = False
    instead_of: str = ""


class _Entry(Table):
    """An effect: its equation is `F` at joints and bodies, `y` at inputs and outputs, or a `function` in Python."""

    title: str
    kind: SiteKind | tuple[SiteKind, ...]
    F: Expression | None = None
    y: Expression | None = None
    where: dict[str, Expression] = Field(default_factory=dict)
    states: dict[str, Expression] | int = Field(default_factory=dict)
    function: str = ""
    memory: str = ""
    ahead: str = ""
    form: str = ""
    remark: str = ""
    source: str
    contains: tuple[str, ...] = ()
    needs: tuple[Need, ...] = ()
    unless: tuple[Need, ...] = ()
    stand_ins: tuple[str, ...] = ()
    caution: str = ""
    compound: bool = False
    least_travel: float = 0.0
    parameters: dict[str, _Parameter] = Field(default_factory=dict)

    @property
    def kinds(self) -> tuple[SiteKind, ...]:
        """The kinds of sites it is for."""
        return (self.kind,) if isinstance(self.kind, str) else self.kind

    @property
    def rates(self) -> Mapping[str, Expression]:
        """The derivatives of its states."""
        return {} if isinstance(self.states, int) else self.states

    @property
    def equations(self) -> str:
        """Its equations as one reads them."""
        if self.form:
            return self.form
        text = f"F = {self.F.text}" if self.F else f"y = {self.y.text}" if self.y else ""
        text += "".join(f", d{name}/dt = {rate.text}" for name, rate in self.rates.items())
        text += "".join(f", {name} = {expression.text}" for name, expression in self.where.items())
        return text + (f"; {self.remark}" if self.remark else "")

    def faults(self) -> Iterator[tuple[tuple[str, ...], str]]:
        """Return what does not fit together, by key."""
        force = bool(self.kinds) and self.kinds[0] in FORCED
        if any((kind in FORCED) != force for kind in self.kinds):
            yield ("kind",), "an effect is either for joints and bodies or for inputs and outputs"
            return
        name, equation, stray = ("F", self.F, self.y) if force else ("y", self.y, self.F)
        if (equation is None) == (not self.function) or stray is not None:
            yield (), f"an effect at {self.kinds[0]} sites needs either {name}, its equation, or a function"
            return
        for own, shape in self.parameters.items():
            other = self.parameters.get(shape.instead_of)
            if shape.instead_of and not (shape.held and other is not None and other.held):
                yield ("parameters", own, "instead_of"), "a shape stands in for another shape of its effect"
        known = [*(_SITE if force else _SIGNAL), *self.parameters, *self.rates]
        for helper, expression in self.where.items():
            yield from _strangers(("where", helper), expression, known)
            known.append(helper)
        for state, rate in self.rates.items():
            yield from _strangers(("states", state), rate, known)
        if equation is not None:
            yield from _strangers((name,), equation, [*known, *(f"d{state}" for state in self.rates)])

    def compiled(self) -> NativeFunction:
        """Return the force law or the filter."""
        force = self.kinds[0] in FORCED
        if self.F is not None:
            return law(self.F, self.rates, self.where, list(self.parameters))
        if self.y is not None:
            return signal_step(self.y, self.where, list(self.parameters))
        return native("law" if force else "filter", _imported(self.function))

    def used(self) -> set[str]:
        """Return what of the site or of the signals its equations use."""
        names = {
            name
            for rate in (self.F, self.y, *self.where.values(), *self.rates.values())
            if rate
            for name in rate.names
        }
        return names - {*self.parameters, *self.where, *self.rates}


def read_effects(
    path: str | Path, *, text: str | None = None, origin: str | None = None
) -> tuple[Effect, ...]:
    """Return the effects of a TOML file, one for each entry and kind of site.

    Parameters
    ----------
    path
        The file; see docs/add-a-model.md and ``labrun/effects/*.toml``.
    text
        What it holds, where it is not written.
    origin
        How files of models are to name it; None for its path.

    Raises
    ------
    ModelError
        All that does not hold, each with file, line and key.
    """
    path = Path(path)
    text = text_of(path, kind=ModelError) if text is None else text
    data = parsed(text, str(path), kind=ModelError)
    shared, effects_, faults = data.get("shared", {}), [], []
    for id_, table in data.items():
        if id_ == "shared":
            continue
        filled = _filled(table, shared)
        entry, wrong = validate(_Entry, filled, (id_,))
        faults += wrong
        if isinstance(entry, _Entry):
            faults += [Fault((id_, *key), message, at_value=bool(key)) for key, message in entry.faults()]
            effects_.append((id_, entry))
    if faults:
        raise refusal(ModelError, str(path), Places(str(path), text, data).of_all(faults))
    where = str(path) if origin is None else origin
    return tuple(effect for id_, entry in effects_ for effect in _effects(id_, entry, where))


def _filled(table: Any, shared: Mapping[str, Any]) -> Any:
    """Return an entry in which what is "shared" is what the file's table [shared] says under that name."""
    if not isinstance(table, dict):
        return {}
    filled = dict(table)
    for part in ("parameters", "where", "states"):
        own = table.get(part)
        if isinstance(own, dict):
            filled[part] = {
                name: shared.get(name, given) if given == "shared" else given for name, given in own.items()
            }
    return filled


def _effects(id_: str, entry: _Entry, origin: str) -> Iterator[Effect]:
    used, function = entry.used(), entry.compiled()
    needs: tuple[Need, ...] = tuple(need for need in get_args(Need) if need in used or need in entry.needs)
    parameters = tuple(
        EffectParameter(name=name, **dict(parameter)) for name, parameter in entry.parameters.items()
    )
    for kind in entry.kinds:
        yield Effect(
            id=id_,
            kind=kind,
            parameters=parameters,
            function=function,
            form=entry.equations,
            source=entry.source,
            states=entry.states if isinstance(entry.states, int) else len(entry.states),
            memory=_imported(entry.memory) if entry.memory else None,
            ahead=entry.ahead,
            needs=needs,
            unless=entry.unless,
            stand_ins=entry.stand_ins,
            needs_acceleration="acceleration" in used,
            signals=1 + ("other" in used),
            contains=entry.contains,
            caution=entry.caution,
            compound=entry.compound,
            least_travel=entry.least_travel,
            title=entry.title,
            origin=origin,
            arguments=frozenset(used),
        )


def _strangers(
    key: tuple[str, ...], expression: Expression, known: list[str]
) -> Iterator[tuple[tuple[str, ...], str]]:
    for name in expression.names:
        if name not in known:
            yield key, f"unknown name {name!r}; {suggest(name, known)}"


def _imported(name: str) -> Any:
    return registry.load("labrun.effects", name)


_GROUP = "labrun.effects"


def load_effect(name: str, kind: SiteKind | None = None) -> Effect:
    """Return an effect.

    Parameters
    ----------
    name
        The id of an effect that ships with labrun, or that a plugin brings; ``"file.toml:id"``; or
        ``"package.module:EFFECT"``, where the object is an `Effect`, or a tuple of effects that share the id at
        different kinds of sites.
    kind
        The kind of site it is for; needed where there is more than one.

    Raises
    ------
    PluginError
        Unknown, does not import, or is no effect.
    ModelError
        There is none for that kind of site, or there are several and `kind` is None; or its file does not hold.
    """
    named = _named(name)
    fitting = [effect for effect in named if kind in (None, effect.kind)]
    if len(fitting) == 1:
        return fitting[0]
    kinds = ", ".join(effect.kind for effect in named)
    if not fitting:
        raise ModelError(f"effect {name} sits at {kinds} sites, not at a {kind} site")
    raise ModelError(f'effect {name} is there for {kinds} sites: say which, as kind = "{fitting[0].kind}"')


def effects(without: Collection[str] = ()) -> tuple[Effect, ...]:
    """Return every effect that ships with labrun or is installed, in the order of their names.

    Parameters
    ----------
    without
        Names of effects, or of plugins that are then not even imported: one that is broken does no harm.

    Raises
    ------
    PluginError
        A plugin does not import, or is no effect.
    """
    numbered = [(effect.id, effect) for effect in shipped() if effect.id not in without]
    for plugin in registry.names(_GROUP):
        if plugin not in without:
            numbered += [(plugin, effect) for effect in _of_plugin(plugin)]
    return tuple(effect for _, effect in sorted(numbered, key=lambda pair: pair[0]))


@functools.cache
def shipped() -> tuple[Effect, ...]:
    """Return the effects that ship with labrun."""
    files = sorted(Path(__file__).parent.glob("*.toml"))
    return tuple(effect for file in files for effect in read_effects(file, origin=""))


def _named(name: str) -> tuple[Effect, ...]:
    file, colon, id_ = name.rpartition(":")
    if colon and file.endswith(".toml"):
        there = read_effects(Path(file))
        if matching := tuple(effect for effect in there if effect.id == id_):
            return matching
        raise PluginError(f"{file} has no effect {id_!r}", hint=suggest(id_, {effect.id for effect in there}))
    own = tuple(effect for effect in shipped() if effect.id == name)
    if own or colon or registry.is_installed(_GROUP, name):
        return own or _of_plugin(name)
    # a plugin may bring a whole file of effects under a name of its own
    brought = tuple(effect for effect in effects() if effect.id == name)
    if brought:
        return brought
    known = [*(effect.id for effect in effects()), *registry.names(_GROUP)]
    raise PluginError(f"unknown effect plugin {name!r}", hint=suggest(name, known))


def _of_plugin(name: str) -> tuple[Effect, ...]:
    loaded = registry.load(_GROUP, name)
    group = loaded if isinstance(loaded, tuple) else (loaded,)
    for effect in group:
        if not isinstance(effect, Effect):
            raise PluginError(
                f"effect plugin {name!r} gives {type(effect).__name__}, not labrun.effects.Effect"
            )
    return group
