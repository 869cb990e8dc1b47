"""Before any data: trials inside the limits, which effects each makes visible at which size, and which none can."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, EffectParameter, Scale
from labrun.errors import RequestError
from labrun.fit import Dataset, Each, Note, OutputNoise, Problem, one_by_one, silent
from labrun.gap import criteria
from labrun.gap.candidates import candidates, site_scales
from labrun.gap.diagnosis import Name, ResampledNumber
from labrun.gap.intervals import effect_units
from labrun.gap.next.imitation import Change, Imitation
from labrun.gap.next.run_bench import RunBench
from labrun.gap.next.separation import greedy
from labrun.gap.next.trials import NEXT_REPEATS, PlannedTrial, evenly, planned_data
from labrun.models import Model, simulate
from labrun.notebook import as_reported
from labrun.store import SignalInfo

_ASSUMED_NOISE = 0.01
"""Noise of one trial where nobody states it."""
_PLANNED_SEEN = 5.0
"""Standard deviations beyond all that parameters imitate, at which an effect counts as visible."""
_PLANNED_ALIKE = 0.95
"""Cosine between changes above which these trials would not tell two effects apart."""
_PLANNED_OWN = 8
"""Most trials of the experiment itself that are looked at."""
_PLANNED_OTHERS = 24
"""Most other trials that are looked at."""
_PLANNED_GAIN = 0.05
"""A further trial is worth it while it makes effects visible that are smaller by this, on average, in e-folds."""

_SIZES = (1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
"""Sizes that are tried, as parts of what is typical at the site."""
_MIDDLE = 3
"""Place of the middle one."""
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

    def _repr_html_(self) -> str:
        return as_reported("trial_plan_text", self)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap plan --json`` prints."""
        return {
            "file": None if self.file is None else str(self.file),
            "model": self.model,
            "trials": [
                {"label": trial.label, "condition": dict(trial.condition), "rig_time_s": trial.cost_s}
                for trial in self.trials
            ],
            "repeats": self.repeats,
            "time_s": self.time_s,
            "effects": [
                {
                    "effect": effect.name.effect,
                    "site": effect.name.site,
                    "parameter": effect.parameter,
                    "visible_from": None if effect.size is None else effect.size.value,
                    "unit": "" if effect.size is None else effect.size.unit,
                    "best_trial": None if effect.best < 0 else effect.best,
                    "why": effect.why,
                    "looks_like": [str(name) for name in effect.alike],
                }
                for effect in self.visible
            ],
            "noise": {name: sd.value for name, sd in self.noise.items()},
            "looked_at": self.looked_at,
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class _Tried:
    """An effect at several sizes, in all trials of the pool.

    Attributes
    ----------
    main
        Its parameter that tells the size.
    sizes
        Of that parameter, SI, from small to large effects.
    changes
        What each size changes; trial by trial at the middle one alone.
    """

    attached: AttachedEffect
    main: EffectParameter
    sizes: tuple[float, ...]
    changes: tuple[Change, ...]

    @property
    def middle(self) -> Change:
        """What is changed by the size at which trials are chosen, and effects held against one another."""
        return self.changes[_MIDDLE]


def plan_trials(
    model: Model,
    bench: RunBench,
    rng: np.random.Generator,
    *,
    noise: Mapping[str, float] | None = None,
    repeats: int = NEXT_REPEATS,
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
    noise : output -> standard deviation of spread trial, in the output's unit
        1 % of what the output moves over if not given.
    out
        The experiment file to write; none if None.

    Raises
    ------
    RequestError
        Noise of an output that the model has not, or a model that does not simulate the experiment.
    """
    note("looking what the rig allows")
    pool = [
        *bench.trials(evenly(bench.measured, _PLANNED_OWN)),
        *evenly(bench.pool(rng), _PLANNED_OTHERS),
    ]
    notes: list[str] = []
    kept, outputs = _simulated(model, pool, notes)
    data = planned_data(_empty(model, bench), kept, outputs, repeats)
    problem = Problem.of(model, data)
    sd = _noise(model, problem.spread, noise or {})
    problem = problem.with_noise(OutputNoise(np.sqrt(repeats) / sd))
    z = problem.begin()
    library = [
        (candidate.attached, candidate.scale)
        for candidate in candidates(model, site_scales(problem, z))
        if candidate.attached is not None and candidate.scale is not None
    ]
    note(f"trying {len(library)} effects in {len(kept)} trials")
    imitation = Imitation(problem, z, np.diag(problem.priors.slope**2 + _RIDGE))
    base = problem.residuals(z)
    tried = each(lambda arguments: _tried(problem, z, base, imitation, *arguments), library)
    chosen = _chosen(kept, tried, imitation)
    visibilities = [
        _visible(effect, imitation, chosen, effect_units(effect.attached, model, data)) for effect in tried
    ]
    held = _held_against(visibilities, tried, imitation, chosen)
    held.sort(key=lambda visibility: visibility.size is None)
    trials = tuple(kept[index] for index in chosen)
    plan = bench.plan(trials)
    if bench.set_by_hand:
        notes.append(f"Somebody at the bench sets {', '.join(bench.set_by_hand)}: no motion does.")
    if noise is None or len(noise) < len(model.outputs):
        notes.append(
            "noise is assumed where it is not stated: --noise OUTPUT=SIZE states it, sizes scale with it"
        )
    if out is not None:
        seen = sum(visibility.size is not None for visibility in held)
        remarks = [
            f"Planned before any data: these trials make {seen} of {len(held)} effects visible, see labrun gap plan."
        ]
        bench.write(out, trials, remarks, None)
    units = {output.name: output.unit for output in model.outputs}
    sizes = {
        name: ResampledNumber(float(spread), float(spread), float(spread), units[name])
        for name, spread in zip(units, sd, strict=True)
    }
    return TrialPlan(
        out, model.name, trials, repeats, bench.time_s(plan), tuple(held), sizes, len(kept), tuple(notes)
    )


def _simulated(
    model: Model, pool: Sequence[PlannedTrial], notes: list[str]
) -> tuple[list[PlannedTrial], list[FloatArray]]:
    """Return the trials that the model simulates, and what they would measure but for noise."""
    shown = {output.name for output in model.outputs}
    kept, outputs = [], []
    for trial in pool:
        begin = {state: trial.begin_rad if state in shown else 0.0 for state in model.states}
        first = {**model.told_first(trial.inputs[0]), **begin}
        start = model.initial_state(trial.condition, first=first, free=begin)
        simulated = simulate(
            model, trial.time_s, trial.inputs, condition=trial.condition, initial_state=start
        )
        if simulated.finite and np.any(np.ptp(simulated.outputs, axis=0) > 0):
            kept.append(trial)
            outputs.append(simulated.outputs)
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
    inputs = tuple(SignalInfo(signal.name, signal.unit) for signal in model.inputs)
    outputs = tuple(SignalInfo(output.name, output.unit) for output in model.outputs)
    return Dataset(bench.name, Path(bench.name), "run", inputs, outputs, ())


def _noise(model: Model, spread: FloatArray, stated: Mapping[str, float]) -> FloatArray:
    names = [output.name for output in model.outputs]
    for name, value in stated.items():
        if name not in names or not value > 0:
            raise RequestError(
                f"noise {name} = {value:g}: a positive size of an output of {model.name} was expected",
                hint=f"its outputs are {', '.join(names)}",
            )
    return np.array(
        [stated.get(name, _ASSUMED_NOISE * size) for name, size in zip(names, spread, strict=True)]
    )


def _tried(
    problem: Problem,
    z: FloatArray,
    base: Sequence[FloatArray],
    imitation: Imitation,
    attached: AttachedEffect,
    scale: Scale,
) -> _Tried:
    """Return what an effect changes at several sizes of it."""
    added = problem.with_effects([attached], [scale])
    fitted = [parameter for parameter in attached.effect.parameters if not parameter.held]
    main = next((parameter for parameter in fitted if parameter.neutral is not None), fitted[0])
    sizes, changes = list[float](), list[Change]()
    for part in _SIZES:
        values = [_value(parameter, part) for parameter in fitted]
        z_with = np.insert(z, problem.size, values)
        parameters = added.parameters(z_with)
        differences = []
        for index, before in enumerate(base):
            after = added.trial_residual(parameters, index, added.own(z_with, index))
            differences.append(np.zeros_like(before) if after is None else after - before)
        change = imitation.change(differences)
        changes.append(change if len(changes) == _MIDDLE else replace(change, parts=()))
        sizes.append(float(values[fitted.index(main)] * scale.of(main.quantity)))
    return _Tried(attached, main, tuple(sizes), tuple(changes))


def _value(parameter: EffectParameter, part: float) -> float:
    """Return the scaled value at which an effect has a part of its typical size."""
    start = parameter.starts[0]
    if parameter.neutral is None:
        return start
    # a level vanishes far out: the lower it is, the more it shows
    value = np.copysign(part, start) if np.isfinite(parameter.neutral) else 1.0 - 0.9 * part
    return float(np.clip(value, parameter.lower, parameter.upper))


def _chosen(pool: Sequence[PlannedTrial], tried: Sequence[_Tried], imitation: Imitation) -> list[int]:
    """Return the trials that lower the sizes that are visible most for their time, one after the other."""

    def value(chosen: Sequence[int]) -> float:
        strengths = [imitation.remaining(effect.middle, chosen) ** 0.5 for effect in tried]
        # what is far beyond visible, or far from it, need not become more so
        room = 0.1 * _PLANNED_SEEN, 20.0 * _PLANNED_SEEN
        return float(np.mean(np.log(np.clip(strengths, *room)))) if strengths else 0.0

    return greedy(value, [trial.cost_s**0.5 for trial in pool], lambda _: _PLANNED_GAIN)


def _imitated(tried: _Tried, strengths: FloatArray, chosen: Sequence[int]) -> bool:
    """Tell whether parameters do nearly the same: asked of the smallest change, where linear projection is true."""
    for change, strength in zip(tried.changes, strengths, strict=True):
        whole = float(change.squares[chosen].sum()) ** 0.5
        if whole > _NUMERICAL:
            return bool(strength <= criteria.IMITATED * whole)
    return True


def _held_against(
    visibles: Sequence[Visible], tried: Sequence[_Tried], imitation: Imitation, chosen: Sequence[int]
) -> list[Visible]:
    """Return what is visible with the names of what would look the same."""
    alike = imitation.cosines([effect.middle for effect in tried], chosen) > _PLANNED_ALIKE
    seen = [visible.size is not None for visible in visibles]
    return [
        replace(
            visible,
            alike=tuple(
                other.name for at, other in enumerate(visibles) if at != row and seen[at] and alike[row, at]
            ),
        )
        if seen[row]
        else visible
        for row, visible in enumerate(visibles)
    ]


def _visible(tried: _Tried, imitation: Imitation, chosen: Sequence[int], units: Mapping[str, str]) -> Visible:
    """Return the size from which on the chosen trials show an effect; whether any trial of the pool would."""
    name, main, seen = Name(tried.attached.effect.id, tried.attached.site), tried.main, _PLANNED_SEEN
    strengths = np.sqrt([imitation.remaining(each, chosen) for each in tried.changes])
    imitated = _imitated(tried, strengths, chosen)
    if imitated or np.max(strengths) < seen:
        whole = max(float(each.squares[chosen].sum()) ** 0.5 for each in tried.changes)
        every = range(len(tried.middle.squares))
        why = (
            "moves nothing here"
            if whole < seen
            else "parameters and initial states imitate it"
            if imitated or max(imitation.remaining(each, every) for each in tried.changes) < seen**2
            else "only all trials together would show it"
        )
        return Visible(name, main.name, None, -1, why)
    first = int(np.argmax(strengths >= seen))
    size = abs(tried.sizes[first])
    if first > 0 and strengths[first - 1] > 0:  # between the two, in logarithms
        low, high = np.log(strengths[first - 1 : first + 1])
        part = (np.log(seen) - low) / (high - low)
        size = float(np.exp((1 - part) * np.log(abs(tried.sizes[first - 1])) + part * np.log(size)))
    elif np.isfinite(main.neutral if main.neutral is not None else 0.0):
        size *= seen / float(strengths[first])  # smaller than all that were tried, where effects are linear
    alone = [imitation.remaining(tried.changes[first], [index]) for index in chosen]
    visible = ResampledNumber(size, size, size, units[main.name])
    return Visible(name, main.name, visible, int(np.argmax(alone)))
