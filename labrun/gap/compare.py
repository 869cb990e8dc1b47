"""Two units, days or gains held against one model: which parameter or effect differs beyond noise, which does not."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.fit import Dataset, Each, Note, Problem, minimise, one_by_one, search, silent, student
from labrun.gap import criteria
from labrun.gap.averaging import averaged
from labrun.gap.candidates import Candidate, candidates, site_scales
from labrun.gap.diagnosis import Name, ResampledNumber
from labrun.gap.intervals import effect_units
from labrun.gap.noise import from_reading_errors, from_repeats, from_residual
from labrun.gap.recalibration import as_stated, in_units_of, member_residuals, stated_problem
from labrun.gap.screening import Base, Survey, refit, rough, survey
from labrun.gap.unit_pair import BOTH, FIRST, SECOND, UNIT, UnitPair, both_units
from labrun.gap.unit_scatter import kept_unseen, scatter_of_trials
from labrun.models import Model
from labrun.notebook import as_reported

_DIFFERENCES_FITTED = 4
_DIFFERENCE_ROUNDS = 6
"""Candidates that are fitted in each round, the most promising ones, and most rounds."""
_DIFFERENCE_AS_GOOD = 0.02
_DIFFERENCE_LITTLE = 0.1
"""What removes less than the best by this part of that, or of what the best leaves, says as much."""
_DIFFERENCE_KEPT = 0.5
"""Part of its gain that a difference must keep on trials it did not see."""
_KNOWN_NOT_TO_DIFFER = 0.2
"""Half an interval, as a part of the value, up to which it may be said that something does not differ."""


@dataclass(frozen=True)
class UnitDifference:
    """A parameter of the model, or the size of an effect, in both units.

    Attributes
    ----------
    name, parameter
        Of a parameter, `parameter` is its own name; of an effect, that of its size.
    first, second
        Its value in each; where it does not differ, the common one.
    change
        Second less first, with a 95 % interval.
    verdict
        "differs"; "both lack": an effect that the model has in neither; "same", to within a fifth of the value; "open".
    or_else
        What would explain these data as well.
    """

    name: Name
    parameter: str
    first: float
    second: float
    change: ResampledNumber
    verdict: str
    or_else: tuple[str, ...] = ()


@dataclass(frozen=True)
class UnitComparison:
    """What differs between two units.

    Attributes
    ----------
    share
        Of what all parameters together could remove of the misfit by differing, the part the named differences remove.
    """

    first: str
    second: str
    model: str
    trials: tuple[int, int]
    differences: tuple[UnitDifference, ...]
    share: float | None
    notes: tuple[str, ...]

    @property
    def differing(self) -> tuple[UnitDifference, ...]:
        """What differs beyond noise."""
        return tuple(one for one in self.differences if one.verdict == "differs")

    def _repr_html_(self) -> str:
        return as_reported("units_text", self)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap compare --json`` prints."""
        return {
            "first": self.first,
            "second": self.second,
            "model": self.model,
            "trials": list(self.trials),
            "differences": [
                {
                    **one.name.to_json(),
                    "parameter": one.parameter,
                    "first": one.first,
                    "second": one.second,
                    "change": {"value": one.change.value, "ci95": [one.change.low, one.change.high]},
                    "unit": one.change.unit,
                    "verdict": one.verdict,
                    "or_else": list(one.or_else),
                }
                for one in self.differences
            ],
            "share": self.share,
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class _InUnit(Candidate):
    """An effect of the library that one unit alone would have."""

    unit: str = SECOND

    def added_to(self, problem: Problem) -> Problem:
        if not isinstance(problem, UnitPair) or self.attached is None or self.scale is None:
            raise TypeError("an effect of one unit belongs in a pair of units")
        return problem.with_effect_in(self.unit, self.attached, self.scale)


@dataclass(frozen=True)
class _Try:
    """One difference more: of a variable, or an effect in one unit; and the fit with it."""

    words: str
    variable: int | None
    candidate: _InUnit | None
    problem: UnitPair
    z: FloatArray
    gain: float

    @property
    def added(self) -> int:
        return 1 if self.candidate is None else self.candidate.variables

    @property
    def common(self) -> bool:
        """Tell whether it is no difference, but something that both units have and the model lacks."""
        return self.candidate is not None and self.candidate.unit == BOTH

    @property
    def rank(self) -> tuple[int, int]:
        """What comes first among things that explain as much."""
        return (0 if self.candidate is None else 1 if self.common else 2), self.added


def compare_units(
    first: Dataset,
    second: Dataset,
    model: Model,
    rng: np.random.Generator,
    *,
    names: tuple[str, str] = (FIRST, SECOND),
    each: Each = one_by_one,
    note: Note = silent,
) -> UnitComparison:
    """Say which parameter or effect differs between two units beyond noise, and which does not.

    One model is fitted to both, its parameters and the sizes of its effects the same; then, one after the other, what
    explains most by differing is let differ: a parameter, a size, or an effect of the library that one unit alone has.
    It counts where its change is beyond what trials scatter by, at 5 % over all that was tried (Bonferroni); intervals
    come from the scatter of the trials' own pulls (the sandwich of White 1980 with a trial as cluster).

    Parameters
    ----------
    names
        What the two are called.

    Raises
    ------
    RequestError
        The two were not recorded alike.
    FitError
        The model does not simulate them.
    """
    _require_alike(first, second)
    notes = list[str]()
    data = averaged(both_units(first, second), model)
    problem, z = _common(model, data, rng, note)
    pair, base_z = problem, z
    library = _library(problem, z)
    variables, shared = problem.size, list(range(problem.size))
    tried = variables + len(library)
    differing = 0.0
    chosen: list[tuple[_Try, tuple[str, ...]]] = []
    for _ in range(_DIFFERENCE_ROUNDS):
        note(f"looking for what differs ({tried} things that could)")
        round_ = _round(pair, base_z, library, [one for one, _ in chosen], shared, each)
        if not round_:
            break
        most = max(one.gain for one in round_)
        loss = max(_DIFFERENCE_AS_GOOD * most, _DIFFERENCE_LITTLE * (pair.squares(base_z) - most))
        as_good = [one for one in round_ if one.gain >= most - loss]
        best = min(as_good, key=lambda one: (*one.rank, -one.gain))
        deviation, freedom = scatter_of_trials(best.problem, best.z)
        sizes = range(best.problem.size - best.added, best.problem.size)
        strength = max(abs(best.z[one]) / deviation[one] for one in sizes)
        beyond = strength > student(freedom, 1.0 - 0.025 / tried)
        if not beyond or kept_unseen(best.problem, best.z, best.added) < _DIFFERENCE_KEPT:
            break
        rivals = tuple(one.words for one in as_good if one is not best and not _richer(one, best))
        chosen.append((best, rivals))
        pair, base_z = best.problem, best.z
        differing += 0.0 if best.common else best.gain
        shared += sizes if best.common else ()
    note("bounding what does not differ")
    found = _told(pair, base_z, chosen, shared, variables, first)
    left = pair.squares(base_z) - _all_differing(pair, base_z, shared, chosen)
    share = float(differing / (differing + max(left, 0.0))) if differing > 0 else None
    notes += _remarks(data, len(first.trials), len(second.trials))
    return UnitComparison(
        *names, model.name, (len(first.trials), len(second.trials)), found, share, tuple(notes)
    )


def _require_alike(first: Dataset, second: Dataset) -> None:
    mine, theirs = (
        [(one.name, one.unit) for one in (*data.inputs, *data.outputs)] for data in (first, second)
    )
    if mine != theirs:
        raise RequestError(
            f"{second.source} has other channels than {first.source}: {theirs} beside {mine}",
            hint="compare only what was recorded alike",
        )


def _common(model: Model, data: Dataset, rng: np.random.Generator, note: Note) -> tuple[UnitPair, FloatArray]:
    """Fit one model to both units, the sizes of the effects it carries too, in units of the noise."""
    note("fitting one model to both")
    bare = replace(model, effects=())
    plain = stated_problem(model, data)
    scales = site_scales(plain, plain.begin())
    fitted = [
        (one, scales[one.effect.kind, one.site])
        for one in model.effects
        if (one.effect.kind, one.site) in scales
    ]
    if len(fitted) < len(model.effects):  # sizes that nothing shows stay as they are, and the model with them
        bare, fitted = model, []
    problem = as_stated(UnitPair.of(bare, data))
    if fitted:
        problem = problem.with_effects([one for one, _ in fitted], [scale for _, scale in fitted])
    problem = replace(problem, only=("",) * len(fitted)).refined(problem.begin())
    z = search(problem, rng, starts=criteria.RECALIBRATION_STARTS, note=lambda _: None)[0].z
    deviations = member_residuals(problem, z)
    noise = (
        from_repeats(data, deviations) or from_reading_errors(data) or from_residual(data, deviations).plain()
    )
    measured = in_units_of(noise, problem, z)
    return cast("UnitPair", measured), refit(measured, z)


def _library(problem: UnitPair, z: FloatArray) -> list[_InUnit]:
    """Return the effects of the library that the model has not, in either unit."""
    scales = site_scales(problem, z)
    has = {(one.effect.id, one.site) for one in (*problem.effects, *problem.model.effects)}
    found = [
        one
        for one in candidates(problem.model, scales)
        if one.name.kind == "effect" and (one.name.effect, one.name.site) not in has
    ]
    return [
        _InUnit(one.name, one.attached, one.scale, one.starts, unit)
        for one in found
        for unit in (BOTH, SECOND, FIRST)
    ]


def _round(
    problem: UnitPair,
    z: FloatArray,
    library: Sequence[_InUnit],
    chosen: Sequence[_Try],
    shared: Sequence[int],
    each: Each,
) -> list[_Try]:
    """Fit the few most promising differences beside those that are chosen."""
    base = Base.of(problem, z)
    before = base.nuisance.remainder(base.residual, problem.priors.residual(z))
    second = [one.condition[UNIT] == SECOND for one in problem.data.trials]
    gone = {one.variable for one in chosen}

    def promise(variable: int) -> float:
        shared = base.nuisance.jacobian.shared
        line = base.nuisance.remainder(
            [block[:, variable] * there for block, there in zip(shared, second, strict=True)]
        )
        length = float(line @ line)
        return float(before @ line) ** 2 / length if length > 0 else 0.0

    most = _DIFFERENCES_FITTED
    variables = sorted((one for one in shared if one not in gone), key=lambda one: -promise(one))[:most]
    taken = {one.candidate.name for one in chosen if one.candidate is not None}
    looked = each(lambda one: survey(base, one), [one for one in library if one.name not in taken])
    looked = sorted((one for one in looked if one.starts), key=lambda one: -one.potential)
    effects = [
        *[one for one in looked if _unit_of(one) == BOTH][:most],
        *[one for one in looked if _unit_of(one) != BOTH][:most],
    ]
    return [
        *each(lambda one: _let_differ(base, one), variables),
        *each(lambda one: _with_effect(base, one), effects),
    ]


def _unit_of(surveyed: Survey) -> str:
    return cast("_InUnit", surveyed.candidate).unit


def _let_differ(base: Base, variable: int) -> _Try:
    problem = cast("UnitPair", base.problem).differing(variable)
    z = refit(problem, np.insert(base.z, base.problem.size, 0.0))
    words = _named(base.problem, variable)[0].words
    return _Try(words, variable, None, problem, z, base.squares - problem.squares(z))


def _with_effect(base: Base, surveyed: Survey) -> _Try:
    ended = rough(base, surveyed)
    z = refit(ended.problem, ended.z)
    unit, candidate = _unit_of(surveyed), cast("_InUnit", surveyed.candidate)
    words = f"{candidate.name.words} in {'both' if unit == BOTH else f'the {unit} alone'}"
    gain = base.squares - ended.problem.squares(z)
    return _Try(words, None, candidate, cast("UnitPair", ended.problem), z, gain)


def _richer(one: _Try, best: _Try) -> bool:
    """Tell whether an effect contains the one that explains as much."""
    if one.candidate is None or best.candidate is None or one.candidate.attached is None:
        return False
    return best.candidate.name.effect in one.candidate.attached.effect.contains


def _named(problem: Problem, variable: int) -> tuple[Name, str]:
    """Return what a variable is the size of, and its own name."""
    number, _, parameter = problem.priors.names[variable].partition(".")
    if not parameter:
        return Name(number, number, "parameter"), number
    one = problem.effects[int(number)]
    return Name(one.effect.id, one.site), parameter


def _estimate(problem: Problem, z: FloatArray, variable: int, unit: str) -> ResampledNumber:
    deviation, freedom = scatter_of_trials(problem, z)
    scale = problem.priors.scale[variable]
    half = float(student(freedom) * deviation[variable] * scale)
    value = float(z[variable] * scale)
    return ResampledNumber(value, value - half, value + half, unit)


def _told(
    problem: UnitPair,
    z: FloatArray,
    chosen: Sequence[tuple[_Try, tuple[str, ...]]],
    shared: Sequence[int],
    variables: int,
    data: Dataset,
) -> tuple[UnitDifference, ...]:
    """Return what differs, the most telling first, then what does not, then what cannot be told."""
    found, at = [], variables
    values = problem.parameters(z)
    for one, rivals in chosen:
        if one.variable is not None:
            name, parameter = _named(problem, one.variable)
            change = _estimate(problem, z, at, _unit(problem, one.variable, data))
            value = float(values[problem.priors.free[one.variable]])
            found.append(
                UnitDifference(name, parameter, value, value + change.value, change, "differs", rivals)
            )
        elif one.candidate is not None and not one.common:
            for variable in range(at, at + one.added):
                name, parameter = _named(problem, variable)
                size = _estimate(problem, z, variable, _unit(problem, variable, data))
                there = (0.0, size.value) if one.candidate.unit == SECOND else (size.value, 0.0)
                if one.candidate.unit == FIRST:
                    size = ResampledNumber(-size.value, -size.high, -size.low, size.unit)
                found.append(UnitDifference(name, parameter, *there, size, "differs", rivals))
        at += one.added
    taken = {one.variable for one, _ in chosen}
    others = []
    for variable in shared:
        if variable in taken:
            continue
        freed = problem.differing(variable)
        moved = minimise(freed, np.insert(z, problem.size, 0.0), tolerance=1e-4, evaluations=20)
        change = _estimate(freed, moved, freed.size - 1, _unit(problem, variable, data))
        value = float(values[problem.priors.free[variable]])
        narrow = 0.5 * (change.high - change.low) <= _KNOWN_NOT_TO_DIFFER * abs(value)
        known = narrow and change.low <= 0.0 <= change.high
        verdict = "both lack" if variable >= variables else "same" if known else "open"
        others.append(
            UnitDifference(*_named(problem, variable), value, value + change.value, change, verdict)
        )
    order = ("both lack", "same", "open")
    return (*found, *sorted(others, key=lambda one: order.index(one.verdict)))


def _unit(problem: Problem, variable: int, data: Dataset) -> str:
    place = int(problem.priors.free[variable])
    if place < len(problem.model.parameters):
        return problem.model.parameters[place].unit
    number, _, parameter = problem.priors.names[variable].partition(".")
    return effect_units(problem.effects[int(number)], problem.model, data)[parameter]


def _all_differing(
    problem: UnitPair, z: FloatArray, shared: Sequence[int], chosen: Sequence[tuple[_Try, tuple[str, ...]]]
) -> float:
    """Return the sum of squares that is left where everything the units share may differ."""
    free, taken = problem, {one.variable for one, _ in chosen}
    for variable in shared:
        if variable not in taken:
            free = free.differing(variable)
    start = np.insert(z, problem.size, np.zeros(free.size - problem.size))
    return free.squares(minimise(free, start, tolerance=1e-4, evaluations=30))


def _remarks(data: Dataset, first: int, second: int) -> list[str]:
    found = []
    conditions = [
        {
            str({k: v for k, v in one.condition.items() if k != UNIT})
            for one in data.trials
            if one.condition[UNIT] == unit
        }
        for unit in (FIRST, SECOND)
    ]
    if not conditions[0] & conditions[1]:
        found.append(
            "the two have no condition in common: what the model lacks may look like a difference between them"
        )
    if min(first, second) < criteria.FEWEST_UNIT_PIECES:
        found.append(
            f"{first} and {second} trials: intervals rest on blocks of them, and know little of how trials differ"
        )
    return found
