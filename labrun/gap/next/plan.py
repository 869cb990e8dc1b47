"""Before any data: trials inside the limits, which effects each makes visible at which size, and which none can."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import Scale
from labrun.errors import RequestError
from labrun.fit import Dataset, Each, Note, OutputNoise, Problem, one_by_one, silent
from labrun.gap import criteria
from labrun.gap.candidates import Candidate, candidates, site_scales
from labrun.gap.diagnosis import Name, ResampledNumber
from labrun.gap.intervals import effect_units
from labrun.gap.next.proposal import experiment_text, write_experiment
from labrun.gap.next.run_bench import RunBench
from labrun.gap.next.trials import PlannedTrial, planned_data
from labrun.models import Model, simulate
from labrun.store import SignalInfo

NOISE_SHARE = 0.01
"""Noise of one trial where nobody states it: this part of what the output moves over."""
_SEEN = 5.0
"""Standard deviations beyond all that parameters imitate, at which an effect counts as visible."""
_SIZES = (1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
"""Sizes that are tried, as parts of what is typical at the site."""
_MIDDLE = 3
"""Place of the size at which trials are chosen, and effects held against one another."""
_ALIKE = 0.95
"""Cosine between changes above which these trials would not tell two effects apart."""
_OWN, _POOL = 8, 24
"""Most trials of the experiment itself, and beside them, that are looked at."""
_LEAST_GAIN = 0.05
"""A further trial is worth it while it makes effects visible that are smaller by this, on average, in e-folds."""
_RIDGE = 1e-9
_NUMERICAL = 1e-3
"""Change, in units of the noise, below which differences of simulations may be rounding."""


@dataclass(frozen=True)
class Visible:
    """From which size on trials show an effect.

    Attributes
    ----------
    parameter, size
        The effect's size that is just visible with the chosen trials; None where no trial of the pool shows it.
    best
        The chosen trial that shows most of it; -1 where none does.
    why
        Of what is not visible: whether nothing moves by it, or parameters imitate it.
    alike
        Effects that would look the same in these trials.
    """

    name: Name
    parameter: str
    size: ResampledNumber | None
    best: int
    why: str = ""
    alike: tuple[Name, ...] = ()


@dataclass(frozen=True)
class TrialPlan:
    """Trials before any data.

    Attributes
    ----------
    noise : output -> standard deviation of one trial
        As stated or assumed.
    """

    file: Path | None
    model: str
    trials: tuple[PlannedTrial, ...]
    repeats: int
    time_s: float
    visible: tuple[Visible, ...]
    noise: Mapping[str, ResampledNumber]
    looked_at: int
    notes: tuple[str, ...]

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap plan --json`` prints."""
        return {
            "file": None if self.file is None else str(self.file),
            "model": self.model,
            "trials": [
                {"label": one.label, "condition": dict(one.condition), "rig_time_s": one.cost_s}
                for one in self.trials
            ],
            "repeats": self.repeats,
            "time_s": self.time_s,
            "effects": [
                {
                    "effect": one.name.effect,
                    "site": one.name.site,
                    "parameter": one.parameter,
                    "visible_from": None if one.size is None else one.size.value,
                    "unit": "" if one.size is None else one.size.unit,
                    "best_trial": None if one.best < 0 else one.best,
                    "why": one.why,
                    "looks_like": [str(name) for name in one.alike],
                }
                for one in self.visible
            ],
            "noise": {name: one.value for name, one in self.noise.items()},
            "looked_at": self.looked_at,
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class _Signature:
    """What a candidate of one size changes, trial by trial.

    Attributes
    ----------
    size
        Its main parameter, SI.
    mixed : (trials, p), own : (trials,)
        Products of the change with the derivatives by the parameters, and with itself; initial states projected out.
    change : per trial (rows,)
        Of the middle size alone.
    """

    candidate: Candidate
    size: float
    mixed: FloatArray
    own: FloatArray
    change: tuple[FloatArray, ...]


def plan_trials(
    model: Model,
    bench: RunBench,
    rng: np.random.Generator,
    *,
    noise: Mapping[str, float] | None = None,
    repeats: int = criteria.NEXT_REPEATS,
    out: Path | None = None,
    each: Each = one_by_one,
    note: Note = silent,
) -> TrialPlan:
    """Choose trials of a bench that make as many effects as possible visible at as small a size as possible.

    An effect is visible where what it changes of the outputs, less what parameters within their tolerances and
    initial states could imitate, is five times the noise (as repeats leave it). Everything is predicted by the
    model as stated.

    Parameters
    ----------
    noise : output -> standard deviation of one trial, in the output's unit
        1 % of what the output moves over if not given.
    out
        The experiment file to write; none if None.

    Raises
    ------
    RequestError
        Noise of an output that the model has not, or a model that does not simulate the experiment.
    """
    note("looking what the rig allows")
    own = bench.trials(_some(bench.measured, _OWN))
    pool = [*own, *_some(bench.pool(rng), _POOL)]
    notes: list[str] = []
    kept, outputs = _simulated(model, pool, notes)
    data = planned_data(_empty(model, bench), kept, outputs, repeats)
    problem = Problem.of(model, data)
    sd = _noise(model, problem.spread, noise or {})
    problem = problem.with_noise(OutputNoise(np.sqrt(repeats) / sd))
    z = problem.begin()
    scales = site_scales(problem, z)
    library = [one for one in candidates(model, scales) if one.name.kind == "effect"]
    note(f"trying {len(library)} effects in {len(kept)} trials")
    information, spans = _parameters(problem, z)
    base = problem.residuals(z)
    found = each(lambda one: _signatures(problem, z, base, one, spans, information), library)
    prior = np.diag(problem.priors.slope**2)
    chosen = _chosen(kept, found, information, prior)
    told = [
        _visible(one, signatures, chosen, information, prior, model, data)
        for one, signatures in zip(library, found, strict=True)
    ]
    told = _held_against(told, [one[_MIDDLE] for one in found], chosen, information, prior)
    told.sort(key=lambda one: one.size is None)
    trials = tuple(kept[index] for index in chosen)
    plan = bench.plan(trials)
    if bench.set_by_hand:
        notes.append(f"Somebody at the bench sets {', '.join(bench.set_by_hand)}: no motion does.")
    if noise is None or len(noise) < len(model.outputs):
        notes.append(
            "noise is assumed where it is not stated: --noise OUTPUT=SIZE states it, sizes scale with it"
        )
    if out is not None:
        seen = sum(one.size is not None for one in told)
        remarks = [
            f"Planned before any data: these trials make {seen} of {len(told)} effects visible, see labrun gap plan."
        ]
        write_experiment(out, experiment_text(bench, trials, remarks, None))
    units = {one.name: one.unit for one in model.outputs}
    sizes = {
        name: ResampledNumber(float(one), float(one), float(one), units[name])
        for name, one in zip(units, sd, strict=True)
    }
    return TrialPlan(
        out, model.name, trials, repeats, bench.time_s(plan), tuple(told), sizes, len(kept), tuple(notes)
    )


def _some(items: Sequence[Any], most: int) -> list[Any]:
    if len(items) <= most:
        return list(items)
    return [items[place] for place in np.linspace(0, len(items) - 1, most).round().astype(int)]


def _simulated(
    model: Model, pool: Sequence[PlannedTrial], notes: list[str]
) -> tuple[list[PlannedTrial], list[FloatArray]]:
    """Return the trials that the model simulates, and what they would measure but for noise."""
    shown = {one.name for one in model.outputs}
    kept, outputs = [], []
    for trial in pool:
        begin = {state: trial.begin_rad if state in shown else 0.0 for state in model.states}
        first = {**model.told_first(trial.inputs[0]), **begin}
        start = model.initial_state(trial.condition, first=first, free=begin)
        found = simulate(model, trial.time_s, trial.inputs, condition=trial.condition, initial_state=start)
        if found.finite and np.any(np.ptp(found.outputs, axis=0) > 0):
            kept.append(trial)
            outputs.append(found.outputs)
    if not kept:
        raise RequestError(
            f"model {model.name} gives nothing that moves in any trial of this experiment",
            hint="does the experiment drive its inputs, or its conditions say how it begins?",
        )
    if len(kept) < len(pool):
        notes.append(
            f"{len(pool) - len(kept)} of {len(pool)} trials move nothing, or the model breaks in them: left out"
        )
    if any(rule in ("first", "free") for rule in model.initial.values()):
        notes.append("states that no trial has measured yet begin where the joint is told to, at rest")
    return kept, outputs


def _empty(model: Model, bench: RunBench) -> Dataset:
    inputs = tuple(SignalInfo(one.name, one.unit) for one in model.inputs)
    outputs = tuple(SignalInfo(one.name, one.unit) for one in model.outputs)
    return Dataset(bench.name, Path(bench.name), "run", inputs, outputs, ())


def _noise(model: Model, spread: FloatArray, stated: Mapping[str, float]) -> FloatArray:
    names = [one.name for one in model.outputs]
    for name, value in stated.items():
        if name not in names or not value > 0:
            raise RequestError(
                f"noise {name} = {value:g}: a positive size of an output of {model.name} was expected",
                hint=f"its outputs are {', '.join(names)}",
            )
    return np.array([stated.get(name, NOISE_SHARE * size) for name, size in zip(names, spread, strict=True)])


def _parameters(
    problem: Problem, z: FloatArray
) -> tuple[list[tuple[FloatArray, FloatArray]], list[FloatArray]]:
    """Return derivatives by the parameters and what they tell, trial by trial, and the spans of initial states."""
    jacobian = problem.jacobian(z)
    found, spans = [], []
    for shared, own in zip(jacobian.shared, jacobian.own, strict=True):
        span = np.linalg.qr(own)[0] if own.shape[1] else np.empty((len(own), 0))
        left = shared - span @ (span.T @ shared)
        found.append((left, left.T @ left))
        spans.append(span)
    return found, spans


def _signatures(
    problem: Problem,
    z: FloatArray,
    base: Sequence[FloatArray],
    one: Candidate,
    spans: Sequence[FloatArray],
    shared: Sequence[tuple[FloatArray, FloatArray]],
) -> list[_Signature]:
    """Return what a candidate changes at several sizes of it."""
    added = one.added_to(problem)
    found: list[_Signature] = []
    for values, size in _sizes(one):
        there = np.concatenate([z[: problem.size], values, z[problem.size :]])
        parameters = added.parameters(there)
        mixed, own, changes = [], [], []
        for index, (before, span) in enumerate(zip(base, spans, strict=True)):
            after = added.trial_residual(parameters, index, added.own(there, index))
            change = np.zeros_like(before) if after is None else after - before
            change = change - span @ (span.T @ change)
            mixed.append(shared[index][0].T @ change)
            own.append(float(change @ change))
            changes.append(change)
        kept = tuple(changes) if len(found) == _MIDDLE else ()
        found.append(_Signature(one, size, np.array(mixed), np.array(own), kept))
    return found


def _sizes(one: Candidate) -> list[tuple[FloatArray, float]]:
    """Return scaled values of the effect's own variables, from small to large, and the main one in SI."""
    if one.attached is None or one.scale is None:
        return []
    fitted = [parameter for parameter in one.attached.effect.parameters if not parameter.held]
    main = next((place for place, parameter in enumerate(fitted) if parameter.neutral is not None), 0)
    start = np.array([parameter.starts[0] for parameter in fitted])
    scale: Scale = one.scale
    found = []
    for part in _SIZES:
        values = start.copy()
        for place, parameter in enumerate(fitted):
            if parameter.neutral is None:
                continue
            if np.isfinite(parameter.neutral):
                sign = -1.0 if parameter.starts[0] < 0 else 1.0
                values[place] = np.clip(sign * part, parameter.lower, parameter.upper)
            else:  # a level vanishes far out: the lower it is, the more it shows
                values[place] = np.clip(1.0 - 0.9 * part, parameter.lower, parameter.upper)
        found.append((values, float(values[main] * scale.of(fitted[main].quantity))))
    return found


def _strength(
    signature: _Signature,
    chosen: Sequence[int],
    information: Sequence[tuple[FloatArray, FloatArray]],
    prior: FloatArray,
) -> float:
    """Return the norm, in units of the noise, of what parameters cannot imitate of a change."""
    total = prior + sum(information[index][1] for index in chosen) + _RIDGE * np.eye(len(prior))
    mixed = signature.mixed[list(chosen)].sum(axis=0)
    whole = float(signature.own[list(chosen)].sum())
    return (
        float(np.sqrt(max(whole - mixed @ np.linalg.solve(total, mixed), 0.0))) if len(prior) else whole**0.5
    )


def _chosen(
    pool: Sequence[PlannedTrial],
    found: Sequence[Sequence[_Signature]],
    information: Sequence[tuple[FloatArray, FloatArray]],
    prior: FloatArray,
) -> list[int]:
    """Return the trials that lower the sizes that are visible most for their time, one after the other."""
    middle = [one[_MIDDLE] for one in found]

    def value(chosen: Sequence[int]) -> float:
        strengths = [_strength(one, chosen, information, prior) for one in middle]
        # what is far beyond visible, or far from it, need not become more so
        return float(np.mean(np.log(np.clip(strengths, 0.1 * _SEEN, 20.0 * _SEEN)))) if strengths else 0.0

    chosen: list[int] = []
    so_far = value([0]) if not middle else float(np.log(0.1 * _SEEN))
    while len(chosen) < min(criteria.NEXT_TRIALS[1], len(pool)):
        rest = [index for index in range(len(pool)) if index not in chosen]
        gains = [value([*chosen, index]) - so_far for index in rest]
        worth = [gain / pool[index].cost_s ** 0.5 for gain, index in zip(gains, rest, strict=True)]
        at = int(np.argmax(worth))
        if len(chosen) >= criteria.NEXT_TRIALS[0] and gains[at] < _LEAST_GAIN:
            break
        chosen.append(rest[at])
        so_far += gains[at]
    return chosen


def _imitated(signatures: Sequence[_Signature], strengths: FloatArray, chosen: Sequence[int]) -> bool:
    """Tell whether parameters do nearly the same: asked of the smallest change, where linear projection is true."""
    for one, left in zip(signatures, strengths, strict=True):
        whole = float(one.own[list(chosen)].sum()) ** 0.5
        if whole > _NUMERICAL:
            return bool(left <= criteria.IMITATED * whole)
    return True


def _held_against(
    told: Sequence[Visible],
    signatures: Sequence[_Signature],
    chosen: Sequence[int],
    information: Sequence[tuple[FloatArray, FloatArray]],
    prior: FloatArray,
) -> list[Visible]:
    """Return what is visible with the names of what would look the same."""
    total = prior + sum(information[index][1] for index in chosen) + _RIDGE * np.eye(len(prior))
    mixed = np.array([one.mixed[list(chosen)].sum(axis=0) for one in signatures])
    whole = np.array([np.concatenate([one.change[index] for index in chosen]) for one in signatures])
    products = whole @ whole.T - mixed @ np.linalg.solve(total, mixed.T)
    size = np.sqrt(np.maximum(np.diag(products), 1e-300))
    cosine = np.abs(products) / np.outer(size, size)
    seen = [one.size is not None for one in told]
    return [
        replace(
            one,
            alike=tuple(
                told[at].name
                for at in range(len(told))
                if at != row and seen[at] and cosine[row, at] > _ALIKE
            ),
        )
        if seen[row]
        else one
        for row, one in enumerate(told)
    ]


def _visible(
    one: Candidate,
    signatures: Sequence[_Signature],
    chosen: Sequence[int],
    information: Sequence[tuple[FloatArray, FloatArray]],
    prior: FloatArray,
    model: Model,
    data: Dataset,
) -> Visible:
    """Return the size from which on the chosen trials show an effect; whether any trial of the pool would."""
    attached = one.attached
    if attached is None:
        raise TypeError("only effects are planned for")
    fitted = [parameter for parameter in attached.effect.parameters if not parameter.held]
    main = next((parameter for parameter in fitted if parameter.neutral is not None), fitted[0])
    unit = effect_units(attached, model, data)[main.name]
    strengths = np.array([_strength(each, chosen, information, prior) for each in signatures])
    strengths *= not _imitated(signatures, strengths, chosen)
    if np.max(strengths, initial=0.0) < _SEEN:
        whole = max(float(each.own[list(chosen)].sum()) ** 0.5 for each in signatures)
        everything = range(len(information))
        most = max(_strength(each, everything, information, prior) for each in signatures)
        why = (
            "moves nothing here"
            if whole < _SEEN
            else "only all trials together would show it"
            if most >= _SEEN and not _imitated(signatures, strengths, chosen)
            else "parameters and initial states imitate it"
        )
        return Visible(one.name, main.name, None, -1, why)
    first = int(np.argmax(strengths >= _SEEN))
    size = abs(signatures[first].size)
    if first > 0 and strengths[first - 1] > 0:  # between the two, in logarithms
        low, high = np.log(strengths[first - 1 : first + 1])
        part = (np.log(_SEEN) - low) / (high - low)
        size = float(np.exp((1 - part) * np.log(abs(signatures[first - 1].size)) + part * np.log(size)))
    elif np.isfinite(main.neutral if main.neutral is not None else 0.0):
        size *= _SEEN / float(strengths[first])  # smaller than all that were tried, where effects are linear
    alone = [_strength(signatures[first], [index], information, prior) for index in chosen]
    return Visible(one.name, main.name, ResampledNumber(size, size, size, unit), int(np.argmax(alone)))
