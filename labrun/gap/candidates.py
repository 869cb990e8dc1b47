"""The candidates: every effect of the library at every site it fits, and every parameter that could be wrong."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from labrun import registry
from labrun.arrays import FloatArray
from labrun.effects import (
    AttachedEffect,
    Effect,
    EffectParameter,
    Quantity,
    Scale,
    effects,
    force_law,
    shipped,
)
from labrun.errors import ModelError, RequestError
from labrun.fit import Problem
from labrun.gap import criteria
from labrun.gap.diagnosis import Name
from labrun.models import Model, Pointer, simulate, site_course
from labrun.toml import suggest

_START_COMBINATIONS = 4
"""About so many combinations of the starts of an effect's parameters are looked at."""
_START_SIZES = (1.0, 0.2, 3.0)
"""Every start is looked at smaller and larger, too."""
_PEAK_PERCENTILE = 99.0
"""Percentile taken as peak."""
_VISIBLE_PUSH = 1e-3
"""Part of its motion by which a probing force must move a site before its answer is taken as linear."""
_STRONGEST_PUSH = 1e12
"""A site that a larger force does not move has no scale of forces."""
_LEAST_LEVEL = 0.9
"""Level of a saturated output, in units of the peak of what was read, which would have passed a lower one."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``force``."""
    return values[0]


_FORCE = EffectParameter("force", "force", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.1,))


def push(model: Model, site: str, force: float) -> AttachedEffect:
    """Return a constant force at a joint or body site."""
    position = next(candidate for candidate in model.sites if candidate.name == site)
    effect = Effect("push", position.kind, (_FORCE,), force_law(law), "F = force", "of the diagnosis itself")
    return AttachedEffect(effect, site, (force,))


def site_scales(problem: Problem, z: FloatArray) -> dict[tuple[str, str], Scale]:
    """Return the scale of every site where something happens: (kind, name) -> typical magnitudes.

    The typical force at a joint is the constant force that would move it as much as it moves in the data: as far, or,
    where nothing holds it, as fast. A site that does not move, or that a force does not move, is left out.
    """
    model = problem.model
    period = typical_time_s(problem)
    scales: dict[tuple[str, str], Scale] = {}
    for index, site in enumerate(model.sites):
        scale = _joint_scale(problem, z, index, period)
        if scale is not None:
            scales[site.kind, site.name] = scale
    for column, signal in enumerate(model.inputs):
        values = np.concatenate([trial.inputs[:, column] for trial in problem.data.trials])
        size = _peak(values)
        if np.ptp(values) > 0 and size > 0:
            scales["input", signal.name] = Scale(signal=size, time_s=period)
    for column, output in enumerate(model.outputs):
        values = np.concatenate([trial.outputs[:, column] for trial in problem.data.trials])
        size = max(_peak(values), float(problem.spread[column]))
        scales["output", output.name] = Scale(signal=size, time_s=period)
    return scales


def typical_time_s(problem: Problem) -> float:
    """Return the period that the outputs' power is centred at, s; a fifth of a trial where they do not oscillate."""
    trials = problem.data.trials
    periods = []
    for trial in trials:
        duration = float(trial.time_s[-1] - trial.time_s[0]) if len(trial.time_s) > 1 else 1.0
        if len(trial.time_s) < 16:
            periods.append(duration)
            continue
        even = np.linspace(trial.time_s[0], trial.time_s[-1], len(trial.time_s))
        power = np.zeros(len(even) // 2 + 1)
        for column in range(trial.outputs.shape[1]):
            values = np.interp(even, trial.time_s, trial.outputs[:, column])
            values = (values - values.mean()) / problem.spread[column]
            power += np.abs(np.fft.rfft(values * np.hanning(len(values)))) ** 2
        frequency = np.fft.rfftfreq(len(even), (even[1] - even[0]))
        total = float(np.sum(power[1:]))
        centre = (
            float(np.exp(np.sum(power[1:] * np.log(frequency[1:])) / total)) if total > 0 else 5.0 / duration
        )
        periods.append(min(1.0 / centre, duration))
    return float(np.median(periods))


def _joint_scale(problem: Problem, z: FloatArray, column: int, period: float) -> Scale | None:
    still = site_courses(problem, z)
    if still is None:
        return None
    motion = [samples[:, column] for samples, _ in still]
    every = np.concatenate(motion)
    coordinate, rate = _peak(every[:, 0]), _peak(every[:, 1])
    if rate <= 0:
        return None
    if coordinate <= 0:  # declared as constant: what it would be is how far the rate goes in a period
        coordinate = rate * period / (2.0 * np.pi)
    times = [trial.time_s for trial in problem.data.trials]
    steps = [
        np.gradient(samples[:, 1], time) for samples, time in zip(motion, times, strict=True) if len(time) > 2
    ]
    acceleration = _peak(np.concatenate(steps)) if steps else 0.0
    force = _force(problem, z, column, still, (coordinate, rate))
    if force is None:
        return None
    longest_s = max(float(time[-1] - time[0]) for time in times)
    return Scale(
        coordinate=coordinate,
        rate=rate,
        acceleration=acceleration if acceleration > 0 else rate / period,
        force=force,
        time_s=period,
        inertia=_inertia(problem, z, column, still, force),
        travel=float(np.ptp(np.clip(every[:, 0], *np.percentile(every[:, 0], _ENDS)))) / 2.0,
        acceleration_time_s=min(2.0 * np.pi * rate / acceleration, longest_s) if acceleration > 0 else 0.0,
        load=_peak(every[:, 2]),
    )


def _inertia(
    problem: Problem, z: FloatArray, column: int, still: list[tuple[FloatArray, FloatArray]], force: float
) -> float:
    """Return what a force moves at a site when it begins to push; 0 where it moves nothing at once."""
    pushed = site_courses(problem, z, [push(problem.model, problem.model.sites[column].name, force)])
    if pushed is None:
        return 0.0
    slopes = [
        float((after[1, column, 1] - before[1, column, 1]) / (trial.time_s[1] - trial.time_s[0]))
        for trial, (after, _), (before, _) in zip(problem.data.trials, pushed, still, strict=True)
        if len(trial.time_s) > 1
    ]
    slope = float(np.median(slopes)) if slopes else 0.0
    return force / slope if slope > 0.0 else 0.0


def _force(
    problem: Problem,
    z: FloatArray,
    joint_index: int,
    still: list[tuple[FloatArray, FloatArray]],
    peaks: tuple[float, float],
) -> float | None:
    """Return the constant force that moves a site as far, or as fast, as it moves in the data.

    Where it moves nothing, as in a relation without states, it is the one that changes an output by its spread. None
    where it changes nothing at all.
    """
    size = 1e-6
    while size < _STRONGEST_PUSH:
        pushed = site_courses(problem, z, [push(problem.model, problem.model.sites[joint_index].name, size)])
        if pushed is None:
            return None
        moved = np.concatenate(
            [
                samples[:, joint_index] - two[:, joint_index]
                for (samples, _), (two, _) in zip(pushed, still, strict=True)
            ]
        )
        shown = np.concatenate([samples - two for (_, samples), (_, two) in zip(pushed, still, strict=True)])
        share = max(_peak(moved[:, 0]) / peaks[0], _peak(moved[:, 1]) / peaks[1])
        if share == 0.0:
            share = max(
                _peak(column) / spread for column, spread in zip(shown.T, problem.spread, strict=True)
            )
        if share > _VISIBLE_PUSH:
            return size / share
        size *= 10.0 if share < 1e-3 * _VISIBLE_PUSH else max(2.0, 3.0 * _VISIBLE_PUSH / share)
    return None


def site_courses(
    problem: Problem, z: FloatArray, added: Sequence[AttachedEffect] = ()
) -> list[tuple[FloatArray, FloatArray]] | None:
    """Return the course of the sites and the outputs of every unit; None if any is not finite."""
    parameters = problem.model_parameters(z)
    attached = (*problem.attached(problem.parameters(z)), *added)
    courses: list[tuple[FloatArray, FloatArray]] = []
    for index, trial in enumerate(problem.data.trials):
        simulation = simulate(
            problem.model,
            trial.time_s,
            problem.drives[index],
            parameters=parameters,
            condition=trial.condition,
            initial_state=problem.initial_state(index, problem.own(z, index)),
            effects=attached,
        )
        if not simulation.finite:
            return None
        course = site_course(
            problem.model,
            trial.time_s,
            simulation.states,
            trial.inputs,
            parameters=parameters,
            condition=trial.condition,
        )
        courses.append((course, simulation.outputs))
    return courses


_ENDS = (100.0 - _PEAK_PERCENTILE, _PEAK_PERCENTILE)


def _peak(values: FloatArray) -> float:
    return float(np.percentile(np.abs(values), _PEAK_PERCENTILE))


@dataclass(frozen=True)
class Candidate:
    """Something that may be missing in the model, and how to add it to a problem.

    Attributes
    ----------
    attached, scale
        Of an effect; None for a parameter.
    starts
        Sizes to start a fit from, in multiples of what is typical at the site, of the variables that are fitted.
    """

    name: Name
    attached: AttachedEffect | None
    scale: Scale | None
    starts: tuple[tuple[float, ...], ...]

    @property
    def variables(self) -> int:
        """Number of variables it adds to a fit."""
        return len(self.quantities)

    @property
    def complexity(self) -> tuple[int, int]:
        """Number of variables, then how uncommon the effect is in practice; a fitted shape counts as uncommon."""
        shapes = max(self.variables - len(self.starts[0]), 0)
        return self.variables, rank(self.name) + len(COMMON) * shapes

    @property
    def fitted(self) -> tuple[str, ...]:
        """Names of the parameters that they are."""
        if self.attached is None:
            return ()
        return tuple(parameter.name for parameter in self.attached.effect.parameters if not parameter.held)

    @property
    def quantities(self) -> tuple[Quantity, ...]:
        """What each of them is."""
        if self.attached is None:
            return ()
        return tuple(
            parameter.quantity for parameter in self.attached.effect.parameters if not parameter.held
        )

    def pace_s(self, sizes: Iterable[float]) -> float:
        """Return the pace of the effect's own states at these sizes, a delay or a period; infinity without any."""
        if self.attached is None or self.scale is None or not self.attached.effect.states:
            return np.inf
        times = ("time", "acceleration-time")
        pairs = zip(self.quantities, sizes, strict=True)
        return min(
            (size * self.scale.of(quantity) for quantity, size in pairs if quantity in times), default=np.inf
        )

    def added_to(self, problem: Problem) -> Problem:
        """Return the problem with this candidate in it."""
        if self.attached is None or self.scale is None:
            parameter = next(
                candidate for candidate in problem.model.parameters if candidate.name == self.name.effect
            )
            return replace(problem, priors=problem.priors.releasing(parameter, criteria.FAR_OFF))
        return problem.with_effects([self.attached], [self.scale])


def candidates(
    model: Model, scales: dict[tuple[str, str], Scale], withhold: Collection[str] = ()
) -> list[Candidate]:
    """Return all candidates of a model.

    Parameters
    ----------
    scales : (kind, site) -> typical magnitudes there
    withhold
        Ids of effects that the library is to be without, and without those that contain them. A plugin of that name
        is not imported.

    Raises
    ------
    RequestError
        An effect to withhold that does not exist.
    """
    library = effects(without=withhold)
    known = sorted({*registry.names("labrun.effects"), *(effect.id for effect in (*shipped(), *library))})
    for name in withhold:
        if name not in known:
            raise RequestError(
                f"unknown effect {name!r} in --withhold", hint=suggest(name, known, kind="effects")
            )
    results = []
    for effect in library:
        if effect.id in withhold or any(name in withhold for name in effect.contains):
            continue
        for site in model.places:
            scale = scales.get((site.kind, site.name))
            if scale is not None and effect.fits(site, scale):
                possible = _as_read(effect) if site.kind == "output" else effect
                attached = possible.attach(site.name, scale)
                try:
                    attached.check(model)
                except ModelError:
                    continue  # it needs a second signal, which this model has not
                results.append(Candidate(Name(effect.id, site.name), attached, scale, _starts(possible)))
    return [*results, *_parameters(model)]


def _as_read(effect: Effect) -> Effect:
    """Return an effect as it may be at an output: a level that readings do not pass is not far below their peak."""

    def possible(parameter: EffectParameter) -> EffectParameter:
        level = parameter.quantity == "signal" and parameter.neutral == np.inf
        return replace(parameter, lower=max(parameter.lower, _LEAST_LEVEL)) if level else parameter

    return replace(effect, parameters=tuple(possible(parameter) for parameter in effect.parameters))


def untried(model: Model, withhold: Collection[str] = ()) -> tuple[str, ...]:
    """Return sentences on effects that no site of the model takes, because none declares what they need."""
    lacking: dict[str, list[str]] = {}
    joints = [location for location in model.places if location.kind == "joint"]
    for effect in effects(without=withhold):
        # where no joint has a drive, nobody misses what is in one; what another effect does in its place is not missed
        if not effect.needs or "drive" in effect.needs or effect.stand_ins:
            continue
        fitting = [joint for joint in joints if effect.kind == "joint" and not effect.fits(joint)]
        if joints and len(fitting) == len(joints):
            lacking.setdefault(effect.needs[0], []).append(effect.id)
    return tuple(
        f"Not tried: {', '.join(names)}; no joint site of the model declares a {need}. Where there is one, add "
        f'{need} = "..." to [sites.{joints[0].name}]; a joint between two masses is a site of its own.'
        for need, names in lacking.items()
    )


def _parameters(model: Model) -> list[Candidate]:
    """Parameters with a stated tolerance; what is free is recalibrated anyway, what is exact is no candidate."""
    return [
        Candidate(Name(parameter.name, parameter.name, "parameter"), None, None, ((),))
        for parameter in model.parameters
        if not isinstance(parameter.tolerance, str) and parameter.tolerance > 0
    ]


def _starts(effect: Effect) -> tuple[tuple[float, ...], ...]:
    """Return combinations of the starts, each at several sizes, within the bounds.

    A parameter with many starts is one that has to be scanned (a number of periods): then all of them are tried.
    """
    fitted = [parameter for parameter in effect.parameters if not parameter.held]
    combined = list(product(*(parameter.starts for parameter in fitted)))
    longest = max((len(parameter.starts) for parameter in fitted), default=0)
    scanned = longest > _START_COMBINATIONS
    step = 1 if scanned else max(1, len(combined) // _START_COMBINATIONS)
    results = []
    for start in combined[::step]:
        for size in _START_SIZES[:1] if scanned else _START_SIZES:
            scaled = [
                value if parameter.neutral is None or not np.isfinite(parameter.neutral) else value * size
                for value, parameter in zip(start, fitted, strict=True)
            ]
            inside = tuple(
                round(min(max(value, parameter.lower), parameter.upper), 9)
                for value, parameter in zip(scaled, fitted, strict=True)
            )
            if inside not in results:
                results.append(inside)
    return tuple(results)


FAMILIES: Mapping[str, tuple[str, ...]] = {
    "dry friction": (
        "coulomb-friction",
        "stribeck-friction",
        "asymmetric-friction",
        "presliding-friction",
    ),
    "hysteretic friction": ("presliding-friction", "hysteresis"),
    "lost motion": ("backlash", "drive-play", "gear-play", "dead-band", "end-stop"),
    "friction under load": ("load-dependent-friction", "gear-efficiency"),
    "lateness": ("lag", "delay"),
}
"""Effects of one family, the common ones first. Presliding friction is dry friction that yields before it slips;
friction that grows with the load is not of that family, since another load shows it. A gear's efficiency is such
friction, with another share where the load drives."""

COMMON = (
    "coulomb-friction", "viscous-damping", "constant-force", "bias", "added-mass", "added-inertia", "gain-error",
    "delay", "lag", "backlash", "drive-play", "gravity-compensation", "stribeck-friction", "load-dependent-friction",
    "saturation", "torque-limit", "end-stop", "dead-band", "quadratic-drag", "cubic-stiffness", "rate-limit",
    "motion-profile", "integral-term", "asymmetric-damping",
)  # fmt: skip
"""How often a bench lacks it, most often first (judged, not counted): friction and offsets are everywhere, and so is
inertia that nobody drew (of a rotor, of a fluid). What is not here comes last."""


def family(first: Name, other: Name) -> str:
    """Return the family that two effects at one site share; empty if they share none, or are the same."""
    if first == other or first.site != other.site:
        return ""
    both = {first.effect, other.effect}
    return next((name for name, members in FAMILIES.items() if both <= set(members)), "")


def rank(name: Name) -> int:
    """Return the place of an effect among what benches lack, from 0."""
    return COMMON.index(name.effect) if name.effect in COMMON else len(COMMON)
