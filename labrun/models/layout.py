"""Model and effects as the flat arrays the kernels take."""

import math
import weakref
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import is_generated
from labrun.effects import FORCED, AttachedEffect, Effect, Site
from labrun.models.model import Model

_MOST_LAYOUTS = 4096
"""Combinations of effects and sites kept for one model."""


@dataclass(frozen=True)
class Forces:
    """The force laws at joint and body sites.

    Attributes
    ----------
    site_values
        Address of the model's site function; 0 where every site is read straight from states and parameters.
    sites : (sites, 5)
        Of each site: the state that is its coordinate, the state that is its rate (-1 where these are expressions),
        the place of its stiffness in `p` (-1 where it declares none or an expression), its first law, and the first
        that is no longer its own.
    laws : (laws, 5)
        Of each law, site by site: address of the machine code, site, whether it depends on acceleration, where its
        values begin, where its states begin, behind the model's own.
    states
        Total number of internal states.
    coupled
        Whether a law depends on acceleration.
    scratch
        Numbers the kernels need for themselves.
    """

    site_values: int
    sites: IntArray
    laws: IntArray
    states: int
    coupled: bool
    scratch: int


@dataclass(frozen=True)
class Filters:
    """The filters of inputs, or of outputs, in the order they are applied.

    Attributes
    ----------
    addresses, channels, offsets, memory_offsets : (filters,)
        Machine code, channel, where values and memory begin.
    memory : (numbers,)
        As it is before the first call: zeros, and its length in the first number of each.
    """

    addresses: IntArray
    channels: IntArray
    offsets: IntArray
    values: FloatArray
    memory_offsets: IntArray
    memory: FloatArray


@dataclass(frozen=True)
class Layout:
    """A model with effects at sites, whatever their values.

    Attributes
    ----------
    derivative, output
        Addresses of the model's functions.
    acting, before, after
        Which of the effects are laws, filters of inputs, filters of outputs.
    effects
        Kept alive, since they are known again by their identity.
    """

    derivative: int
    output: int
    forces: Forces
    acting: tuple[int, ...]
    before: tuple[int, ...]
    after: tuple[int, ...]
    effects: tuple[Effect, ...]


def layout(model: Model, effects: Sequence[AttachedEffect]) -> Layout:
    """Return the layout, made once for each combination of effects and sites of a model.

    Raises ModelError: an effect does not fit, or a value of it is missing or not a number.
    """
    total = 0.0
    for one in effects:
        if len(one.values) != len(one.effect.parameters):
            one.check(model)
        total += sum(one.values)
    if math.isnan(total):  # or infinities of both signs, which are values
        for one in effects:
            one.check(model)
    known = _layouts(model)
    key = tuple([(id(one.effect), one.site) for one in effects])
    found = known.get(key)
    if found is None:
        if len(known) >= _MOST_LAYOUTS:
            known.clear()
        found = known[key] = _laid_out(model, effects)
    return found


def law_values(found: Layout, effects: Sequence[AttachedEffect]) -> FloatArray:
    """Return the values of all laws, one behind the other."""
    if not found.acting:
        return _NO_NUMBERS
    return np.array([value for index in found.acting for value in effects[index].values], dtype=float)


def filters(
    model: Model, effects: Sequence[AttachedEffect], chosen: Sequence[int], shortest_s: float
) -> Filters:
    """Lay out the chosen input or output effects; `shortest_s` is the shortest piece of signal they will see."""
    if not chosen:
        return _NO_FILTERS
    ones = [effects[index] for index in chosen]
    order = [one.name for one in (model.inputs if ones[0].effect.kind == "input" else model.outputs)]
    lengths = [max(1, one.effect.memory(one.values, shortest_s)) if one.effect.memory else 1 for one in ones]
    memory_offsets = _offsets(lengths)
    memory = np.zeros(sum(lengths))
    memory[memory_offsets] = lengths
    return Filters(
        addresses=_integers([one.effect.function.address for one in ones]),
        channels=_integers([order.index(one.site) for one in ones]),
        offsets=_integers(_offsets([len(one.values) for one in ones])),
        values=np.array([value for one in ones for value in one.values], dtype=float),
        memory_offsets=_integers(memory_offsets),
        memory=memory,
    )


def _laid_out(model: Model, effects: Sequence[AttachedEffect]) -> Layout:
    for one in effects:
        one.check(model)
    kinds = [one.effect.kind for one in effects]
    acting = tuple(index for index, kind in enumerate(kinds) if kind in FORCED)
    return Layout(
        derivative=model.derivative.address,
        output=model.output.address,
        forces=_forces(model, [effects[index] for index in acting]),
        acting=acting,
        before=tuple(index for index, kind in enumerate(kinds) if kind == "input"),
        after=tuple(index for index, kind in enumerate(kinds) if kind == "output"),
        effects=tuple(one.effect for one in effects),
    )


def _forces(model: Model, chosen: Sequence[AttachedEffect]) -> Forces:
    order = [site.name for site in model.sites]
    rows = [_read(model, site) for site in model.sites]
    states = [one.effect.states for one in chosen]
    laws = sorted(
        zip(
            [one.effect.function.address for one in chosen],
            [order.index(one.site) for one in chosen],
            [int(one.effect.needs_acceleration) for one in chosen],
            _offsets([len(one.effect.parameters) for one in chosen]),
            [len(model.states) + offset for offset in _offsets(states)],
            strict=True,
        ),
        key=lambda law: law[1],
    )
    at = [law[1] for law in laws]
    bounds = [(bisect_left(at, site), bisect_right(at, site)) for site in range(len(rows))]
    coupled = any(one.effect.needs_acceleration for one in chosen)
    total, sites = len(model.states) + sum(states), len(rows)
    return Forces(
        site_values=0 if _all_read(model, rows, chosen) else model.site_values.address,
        sites=_integers([(*row, *bound) for row, bound in zip(rows, bounds, strict=True)]).reshape(sites, 5),
        laws=_integers(laws).reshape(len(chosen), 5),
        states=sum(states),
        coupled=coupled,
        # slopes of 6 stages and the state at the next, force and quantities of the sites; what `couple` divides up
        scratch=7 * total + 5 * sites + (total + sites * (sites + 8) if coupled else 0) + 1,
    )


def _read(model: Model, site: Site) -> tuple[int, int, int]:
    states = model.states
    parameters = [one.name for one in model.parameters]
    return (
        states.index(site.coordinate) if site.coordinate in states else -1,
        states.index(site.rate) if site.rate in states else -1,
        parameters.index(site.stiffness) if site.stiffness in parameters else -1,
    )


def _all_read(model: Model, rows: Sequence[tuple[int, int, int]], chosen: Sequence[AttachedEffect]) -> bool:
    """Tell whether the site function, which a load may make as costly as the equations, need not be called.

    A site function that is written by hand is always called: it may do other than the site's expressions say.
    """
    plain = all(
        coordinate >= 0 and rate >= 0 and (stiffness >= 0 or not site.stiffness)
        for site, (coordinate, rate, stiffness) in zip(model.sites, rows, strict=True)
    )
    return plain and is_generated(model.site_values) and not any(_may_read_load(one.effect) for one in chosen)


def _may_read_load(effect: Effect) -> bool:
    """Tell whether a law may read the load: one in Python need not say so."""
    return "load" in effect.needs or not is_generated(effect.function)


@dataclass
class _Known:
    model: "weakref.ref[Model]"
    layouts: dict[tuple[tuple[int, str], ...], Layout] = field(default_factory=dict)


_KNOWN: dict[int, _Known] = {}
"""By the identity of a model: hashing one would read all its fields, and an address must not travel in a pickle."""


def _layouts(model: Model) -> dict[tuple[tuple[int, str], ...], Layout]:
    key = id(model)
    known = _KNOWN.get(key)
    if known is None or known.model() is not model:
        known = _KNOWN[key] = _Known(weakref.ref(model, lambda _: _KNOWN.pop(key, None)))
    return known.layouts


def _integers(values: Sequence[object]) -> IntArray:
    return np.array(values, dtype=np.int64)


def _offsets(lengths: Sequence[int]) -> list[int]:
    offsets, at = [], 0
    for length in lengths:
        offsets.append(at)
        at += length
    return offsets


_NO_INTEGERS = _integers([])
_NO_NUMBERS = np.empty(0)
_NO_FILTERS = Filters(_NO_INTEGERS, _NO_INTEGERS, _NO_INTEGERS, np.empty(0), _NO_INTEGERS, np.empty(0))
