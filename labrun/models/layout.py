"""Model and effects as the flat arrays the kernels take."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from labrun.models.model import FloatArray, Model

if TYPE_CHECKING:
    from labrun.effects.effect import AttachedEffect

IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Forces:
    """The force laws at joint and body sites.

    Attributes
    ----------
    rate_states : (sites,)
        Which state is each site's rate; -1 where the rate is an expression.
    addresses, sites, inertial : (laws,)
        Machine code, site, and whether the law depends on acceleration.
    offsets : (laws,), values : (values,)
        Where each law's values begin.
    state_offsets : (laws,)
        Where each law's states begin, behind the model's own.
    states
        Total number of internal states.
    """

    rate_states: IntArray
    addresses: IntArray
    sites: IntArray
    inertial: IntArray
    offsets: IntArray
    values: FloatArray
    state_offsets: IntArray
    states: int


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


def forces(model: Model, effects: "Sequence[AttachedEffect]") -> Forces:
    """Lay out the joint and body effects."""
    order = [site.name for site in model.sites]
    chosen = [one for one in effects if one.effect.kind in ("joint", "body")]
    rates = [model.states.index(site.rate) if site.rate in model.states else -1 for site in model.sites]
    if not chosen:
        none = _NO_INTEGERS
        return Forces(_integers(rates), none, none, none, none, np.empty(0), none, 0)
    states = [one.effect.states for one in chosen]
    return Forces(
        rate_states=_integers(rates),
        addresses=_integers([one.effect.function.address for one in chosen]),
        sites=_integers([order.index(one.check(model).name) for one in chosen]),
        inertial=_integers([int(one.effect.needs_acceleration) for one in chosen]),
        offsets=_offsets([len(one.values) for one in chosen]),
        values=np.array([value for one in chosen for value in one.values], dtype=float),
        state_offsets=_offsets(states) + len(model.states),
        states=sum(states),
    )


def filters(model: Model, effects: "Sequence[AttachedEffect]", kind: str, shortest_s: float) -> Filters:
    """Lay out the input or output effects; `shortest_s` is the shortest piece of signal they will see."""
    order = [one.name for one in (model.inputs if kind == "input" else model.outputs)]
    chosen = [one for one in effects if one.effect.kind == kind]
    if not chosen:
        return _NO_FILTERS
    lengths = [
        max(1, one.effect.memory(one.values, shortest_s)) if one.effect.memory else 1 for one in chosen
    ]
    memory_offsets = _offsets(lengths)
    memory = np.zeros(sum(lengths))
    memory[memory_offsets] = lengths
    return Filters(
        addresses=_integers([one.effect.function.address for one in chosen]),
        channels=_integers([order.index(one.check(model).name) for one in chosen]),
        offsets=_offsets([len(one.values) for one in chosen]),
        values=np.array([value for one in chosen for value in one.values], dtype=float),
        memory_offsets=memory_offsets,
        memory=memory,
    )


def _integers(values: Sequence[int]) -> IntArray:
    return np.array(values, dtype=np.int64)


def _offsets(lengths: Sequence[int]) -> IntArray:
    return (
        np.concatenate([[0], np.cumsum(lengths)[:-1]]).astype(np.int64)
        if lengths
        else np.empty(0, dtype=np.int64)
    )


_NO_INTEGERS = _integers([])
_NO_FILTERS = Filters(_NO_INTEGERS, _NO_INTEGERS, _NO_INTEGERS, np.empty(0), _NO_INTEGERS, np.empty(0))
