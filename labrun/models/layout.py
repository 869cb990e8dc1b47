"""Model, effects and inputs as the flat arrays the kernels take."""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray, IntArray
from labrun.compiled import is_generated
from labrun.effects import FORCED, AttachedEffect, Effect, Site
from labrun.errors import ModelError
from labrun.models.model import Between, Model

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


class Filters(NamedTuple):
    """The filters of inputs, or of outputs, in the order they are applied, as the kernels take them.

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
    for effect in effects:
        if len(effect.values) != len(effect.effect.parameters):
            effect.check(model)
        total += sum(effect.values)
    if math.isnan(total):  # or infinities of both signs, which are values
        for effect in effects:
            effect.check(model)
    known = model.layouts
    key = tuple([(id(effect.effect), effect.site) for effect in effects])
    out = known.get(key)
    if out is None:
        if len(known) >= _MOST_LAYOUTS:
            known.clear()
        out = known[key] = _laid_out(model, effects)
    return out


def law_values(laid_out: Layout, effects: Sequence[AttachedEffect]) -> FloatArray:
    """Return the concatenated values of all laws."""
    if not laid_out.acting:
        return _NO_NUMBERS
    return np.array([value for index in laid_out.acting for value in effects[index].values], dtype=float)


def filters(
    model: Model, effects: Sequence[AttachedEffect], chosen: Sequence[int], shortest_s: float
) -> Filters:
    """Lay out the chosen input or output effects; `shortest_s` is the shortest piece of signal they will see."""
    if not chosen:
        return _NO_FILTERS
    ones = [effects[index] for index in chosen]
    order = [signal.name for signal in (model.inputs if ones[0].effect.kind == "input" else model.outputs)]
    lengths = [
        max(1, effect.effect.memory(effect.values, shortest_s)) if effect.effect.memory else 1
        for effect in ones
    ]
    memory_offsets = _offsets(lengths)
    memory = np.zeros(sum(lengths))
    memory[memory_offsets] = lengths
    return Filters(
        addresses=_integers([effect.effect.function.address for effect in ones]),
        channels=_integers([order.index(effect.site) for effect in ones]),
        offsets=_integers(_offsets([len(effect.values) for effect in ones])),
        values=np.array([value for effect in ones for value in effect.values], dtype=float),
        memory_offsets=_integers(memory_offsets),
        memory=memory,
    )


def _laid_out(model: Model, effects: Sequence[AttachedEffect]) -> Layout:
    for effect in effects:
        effect.check(model)
    kinds = [effect.effect.kind for effect in effects]
    acting = tuple(index for index, kind in enumerate(kinds) if kind in FORCED)
    return Layout(
        derivative=model.derivative.address,
        output=model.output.address,
        forces=_forces(model, [effects[index] for index in acting]),
        acting=acting,
        before=tuple(index for index, kind in enumerate(kinds) if kind == "input"),
        after=tuple(index for index, kind in enumerate(kinds) if kind == "output"),
        effects=tuple(effect.effect for effect in effects),
    )


def _forces(model: Model, chosen: Sequence[AttachedEffect]) -> Forces:
    order = [site.name for site in model.sites]
    rows = [_read(model, site) for site in model.sites]
    states = [effect.effect.states for effect in chosen]
    laws = sorted(
        zip(
            [effect.effect.function.address for effect in chosen],
            [order.index(effect.site) for effect in chosen],
            [int(effect.effect.needs_acceleration) for effect in chosen],
            _offsets([len(effect.effect.parameters) for effect in chosen]),
            [len(model.states) + offset for offset in _offsets(states)],
            strict=True,
        ),
        key=lambda law: law[1],
    )
    at = [law[1] for law in laws]
    bounds = [(bisect_left(at, site), bisect_right(at, site)) for site in range(len(rows))]
    coupled = any(effect.effect.needs_acceleration for effect in chosen)
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
    parameters = [parameter.name for parameter in model.parameters]
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
    return (
        plain
        and is_generated(model.site_values)
        and not any(_may_read_load(effect.effect) for effect in chosen)
    )


def _may_read_load(effect: Effect) -> bool:
    """Tell whether a law may read the load: one in Python need not say so."""
    return "load" in effect.needs or not is_generated(effect.function)


def _integers(values: Sequence[object]) -> IntArray:
    return np.array(values, dtype=np.int64)


def _offsets(lengths: Sequence[int]) -> list[int]:
    return list(accumulate(lengths, initial=0))[:-1]


_NO_INTEGERS = _integers([])
_NO_NUMBERS = np.empty(0)
_NO_FILTERS = Filters(_NO_INTEGERS, _NO_INTEGERS, _NO_INTEGERS, np.empty(0), _NO_INTEGERS, np.empty(0))


_REACH = 64
"""Samples on each side that a band-limited value is made from: flat up to 96 % of the Nyquist frequency."""
_KAISER_BETA = 8.0
"""Window of the sinc: 80 dB stop band (Kaiser 1974)."""
_UNEVEN = 0.02
"""Relative spread of sample intervals up to which a signal counts as evenly sampled (rounded or jittered stamps)."""


@dataclass(frozen=True, eq=False)
class Grid:
    """How the intervals between samples are divided into the integrator's steps.

    Attributes
    ----------
    counts : (samples - 1,)
        Steps in each interval, all of one length.
    """

    counts: IntArray

    @cached_property
    def rows(self) -> IntArray:
        """The step that begins at each sample, and behind them the number of all steps, shape (samples,)."""
        return np.concatenate([[0], np.cumsum(self.counts)])

    @cached_property
    def pairs(self) -> NDArray[np.bool_]:
        """Whether a step and the next may be taken as one, shape (steps,): both of an interval of an even number."""
        number = np.arange(self.rows[-1]) - np.repeat(self.rows[:-1], self.counts)
        return np.asarray((number % 2 == 0) & np.repeat(self.counts % 2 == 0, self.counts))

    @cached_property
    def most(self) -> int:
        """Steps in the interval that has most of them."""
        return int(np.max(self.counts, initial=1))

    def beginning(self, samples: int) -> "Grid":
        """Return the grid of the first samples."""
        return Grid(self.counts[: samples - 1])


@dataclass(frozen=True)
class Drive:
    """Inputs on the integrator's steps.

    Attributes
    ----------
    time_s : (samples,)
    steps_s : (steps,)
        Length of each step.
    u : (steps, 3, inputs)
        At start, middle and end of each step; the end of one and the start of the next differ where an input jumps.
    u_last : (inputs,)
        At the last sample.
    grid
        How many steps there are in each interval between samples.
    ahead
        The same inputs as they were last read ahead, by what was read by how much: a model's own clock stays.
    """

    time_s: FloatArray
    steps_s: FloatArray
    u: FloatArray
    u_last: FloatArray
    grid: Grid
    ahead: dict[object, FloatArray] = field(default_factory=dict, init=False, compare=False, repr=False)

    @property
    def first(self) -> FloatArray:
        """Inputs at the first sample, shape (inputs,)."""
        first: FloatArray = self.u[0, 0] if len(self.u) else self.u_last
        return first

    @property
    def substeps(self) -> int:
        """Steps in the interval between samples that has most of them."""
        return self.grid.most


def drive(
    time_s: FloatArray, inputs: FloatArray, between: Sequence[Between], substeps: int | IntArray
) -> Drive:
    """Lay the inputs of one trial on the integrator's steps.

    Parameters
    ----------
    time_s : (samples,)
        Strictly increasing, s.
    inputs : (samples, inputs)
    between
        How each input runs between its samples.
    substeps : (samples - 1,)
        Steps in each interval; a number stands for all of them.

    Raises
    ------
    ModelError
        Shapes that do not match, times that do not increase, values that are not finite, a band-limited input that is
        not evenly sampled.
    """
    time_s = np.ascontiguousarray(time_s, dtype=float)
    values = np.ascontiguousarray(inputs, dtype=float)
    if values.ndim == 1 and len(between) == 1:
        values = values[:, None]
    if values.size == 0 and not between:
        values = np.empty((len(time_s), 0))
    _check(time_s, values, len(between), substeps)
    intervals = time_s[1:] - time_s[:-1]
    _check_times(time_s, intervals)
    grid = Grid(np.array(np.broadcast_to(substeps, len(intervals)), dtype=np.int64))
    steps_s = np.repeat(intervals / grid.counts, grid.counts)
    u = np.empty((len(steps_s), 3, len(between)))
    for count in np.unique(grid.counts).tolist():
        alike = np.flatnonzero(grid.counts == count)
        steps = grid.rows[alike, None] + np.arange(count)
        fractions = np.arange(2 * count + 1) / (2 * count)
        for index, kind in enumerate(between):
            course = _course(time_s, values[:, index], kind, fractions)[alike]
            for axis in range(3):
                u[steps, axis, index] = course[:, axis : 2 * count - 1 + axis : 2]
    return Drive(time_s, steps_s, u, values[-1].copy(), grid)


def _course(time_s: FloatArray, values: FloatArray, kind: Between, fractions: FloatArray) -> FloatArray:
    """Return a signal at fractions of every interval between its samples, shape (intervals, fractions)."""
    if kind == "hold":
        return np.repeat(values[:-1, None], len(fractions), axis=1)
    if kind == "linear":
        return np.asarray(values[:-1, None] * (1 - fractions) + values[1:, None] * fractions)
    return _band_limited(time_s, values, fractions)


def _check(time_s: FloatArray, values: FloatArray, inputs: int, substeps: int | IntArray) -> None:
    if time_s.ndim != 1 or len(time_s) < 1:
        raise ModelError(f"a simulation needs at least one time; time_s has shape {time_s.shape}")
    if values.shape != (len(time_s), inputs):
        raise ModelError(
            f"{inputs} inputs at {len(time_s)} times were expected; the values have shape {values.shape}"
        )
    if np.ndim(substeps) and np.shape(substeps) != (len(time_s) - 1,):
        raise ModelError(f"{len(time_s) - 1} intervals have steps; substeps has shape {np.shape(substeps)}")
    if np.min(substeps, initial=1) < 1:
        raise ModelError(f"substeps must be 1 or more, not {np.min(substeps)}")
    if values.size and not np.isfinite(values).all():
        row, column = np.argwhere(~np.isfinite(values))[0]
        raise ModelError(f"input {column} is not finite at sample {row} (t = {time_s[row]:g} s)")


def _check_times(time_s: FloatArray, intervals: FloatArray) -> None:
    # not-a-number compares false, and infinite times have an infinite interval or none
    if intervals.size and intervals.min() > 0 and np.isfinite(intervals.max()) and np.isfinite(time_s[0]):
        return
    if not np.isfinite(time_s).all() or intervals.size:
        worst = int(np.argmin(intervals)) if intervals.size else 0
        raise ModelError(f"time_s must increase; at sample {worst + 1} it does not")


def _band_limited(time_s: FloatArray, values: FloatArray, fractions: FloatArray) -> FloatArray:
    """Resample by a windowed sinc, shape (intervals, fractions).

    Beyond its ends the signal is continued by point reflection, which keeps value and slope; what a record's first and
    last `_REACH` samples contain near the Nyquist frequency is therefore a guess. A constant stays exactly constant.
    """
    if len(values) < 3:
        return _course(time_s, values, "linear", fractions)
    intervals = np.diff(time_s)
    spread = np.max(np.abs(intervals - intervals.mean())) / intervals.mean()
    if spread > _UNEVEN:
        worst = int(np.argmax(np.abs(intervals - intervals.mean())))
        raise ModelError(
            f"a band-limited input must be sampled evenly; the interval at t = {time_s[worst]:g} s "
            f"differs by {spread:.0%} from the mean",
            hint='resample the recording, or declare the input between = "linear"',
        )
    padded = np.pad(values, _REACH, mode="reflect", reflect_type="odd")
    taps = np.arange(-_REACH + 1, _REACH + 1)
    result = np.empty((len(intervals), len(fractions)))
    for index, fraction in enumerate(fractions):
        offset = taps - fraction
        window = np.i0(_KAISER_BETA * np.sqrt(np.clip(1 - (offset / _REACH) ** 2, 0, 1)))
        weights = np.sinc(offset) * window
        weights /= weights.sum()
        result[:, index] = np.correlate(padded[1:], weights, mode="valid")[: len(intervals)]
    return result
