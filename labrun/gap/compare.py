"""Two units, days or gains compared with one model: which parameter or effect differs, by how much, which does not.

Both are fitted together. Every parameter, and every size of an effect that the model carries, has an indicator
variable: its difference in the second unit, held at zero. The candidates are those differences, and the effects of the
library in one unit alone or in both. The rule of `labrun.gap.decide` chooses among them as among causes.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.fit import Dataset, Each, FitTrial, Note, Problem, minimise, one_by_one, search, silent
from labrun.gap import criteria, numerics
from labrun.gap.averaging import averaged
from labrun.gap.candidates import COMMON, Candidate, candidates, site_scales
from labrun.gap.diagnosis import Name, ResampledNumber
from labrun.gap.evidence import Units
from labrun.gap.held_out import floor_of, mean_residuals
from labrun.gap.intervals import effect_units, scatter
from labrun.gap.noise import Noise, from_reading_errors, from_repeats, of_sensor
from labrun.gap.paired_problem import BOTH, FIRST, SECOND, UNIT, PairedProblem, difference_of
from labrun.gap.progress import Progress
from labrun.gap.recalibration import as_stated, in_noise, member_residuals, stated_problem
from labrun.gap.screening import Base, refit
from labrun.gap.selection import Chosen, Selection, Selector
from labrun.models import Model
from labrun.notebook import as_reported

_KNOWN_NOT_TO_DIFFER = 0.2
"""Change, as a part of the value, up to which something is said not to differ."""


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
        "differs": by the rule; "both lack": an effect that the model has in neither; "same", to within a fifth of the
        value; "open".
    or_else
        Rivals: what explains these data as well in its place.
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
        return tuple(difference for difference in self.differences if difference.verdict == "differs")

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
                    **difference.name.to_json(),
                    "parameter": difference.parameter,
                    "first": difference.first,
                    "second": difference.second,
                    "change": {
                        "value": difference.change.value,
                        "ci95": [difference.change.low, difference.change.high],
                    },
                    "unit": difference.change.unit,
                    "verdict": difference.verdict,
                    "or_else": list(difference.or_else),
                }
                for difference in self.differences
            ],
            "share": self.share,
            "notes": list(self.notes),
        }


@dataclass(frozen=True)
class _UnitName(Name):
    """Name of an effect in one unit, or of a difference between both, with its words for people."""

    label: str = ""

    def __str__(self) -> str:
        return self.label


@dataclass(frozen=True)
class _Differs(Candidate):
    """A variable that may differ between the units."""

    variable: str = ""

    def added_to(self, problem: Problem) -> Problem:
        return cast("PairedProblem", problem).differing(self.variable)


@dataclass(frozen=True)
class _InUnit(Candidate):
    """An effect of the library in one unit alone, or in both: the latter is the more common."""

    unit: str = BOTH

    @property
    def complexity(self) -> tuple[int, int]:
        variables, uncommon = super().complexity
        return variables, uncommon + (0 if self.unit == BOTH else len(COMMON))

    def added_to(self, problem: Problem) -> Problem:
        if self.attached is None or self.scale is None:
            raise TypeError("an effect of one unit has a site")
        return cast("PairedProblem", problem).with_effect_in(self.unit, self.attached, self.scale)


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
    """Return which parameter or effect differs between two units, by how much, and which does not.

    What both units have and the model lacks is added to the model first; then its sizes are compared, too.

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
    data = averaged(_both_units(first, second), model)
    problem, z, noise = _common(model, data, rng, note)
    lacking = list[str]()
    for _ in range(criteria.MOST_CAUSES):
        base = Base.of(problem, z, brisk=True)
        units = Units.of(data, mean_residuals(problem, z))
        floor = floor_of(data, noise, rng) if noise.known else 0.0
        library = _library(problem, z)
        note(f"looking for what differs ({len(library)} candidates)")
        selector = Selector(base, library, noise, units, floor, rng, Progress(each, note))
        selection = selector.select()
        common = [cause for cause in selection.chosen if getattr(cause.candidate, "unit", None) == BOTH]
        if not common:
            break
        problem, z, added = _with_common(problem, z, selection, common, noise)
        lacking += added
    note("estimating what does not differ")
    differences = _differences(selection, noise, units, rng, lacking)
    remarks = _remarks(data, len(first.trials), len(second.trials))
    share = _share(selection)
    return UnitComparison(
        *names, model.name, (len(first.trials), len(second.trials)), differences, share, tuple(remarks)
    )


def _require_alike(first: Dataset, second: Dataset) -> None:
    channels = [
        [(signal.name, signal.unit) for signal in (*data.inputs, *data.outputs)] for data in (first, second)
    ]
    if channels[0] != channels[1]:
        raise RequestError(
            f"{second.source} has other channels than {first.source}: {channels[1]} instead of {channels[0]}",
            hint="compare two recordings with the same channels in the same units",
        )


def _both_units(first: Dataset, second: Dataset) -> Dataset:
    """Return the trials of both, each with its unit in its condition."""

    def trials_of(data: Dataset, unit: str) -> list[FitTrial]:
        return [replace(trial, condition={**trial.condition, UNIT: unit}) for trial in data.trials]

    return replace(first, trials=(*trials_of(first, FIRST), *trials_of(second, SECOND)))


def _common(
    model: Model, data: Dataset, rng: np.random.Generator, note: Note
) -> tuple[PairedProblem, FloatArray, Noise]:
    """Fit one model to both units, the sizes of the effects it carries too, each with a difference held at zero."""
    note("fitting one model to both")
    bare = replace(model, effects=())
    plain = stated_problem(model, data)
    scales = site_scales(plain, plain.begin())
    fitted = [effect for effect in model.effects if (effect.effect.kind, effect.site) in scales]
    if len(fitted) < len(model.effects):  # sizes that nothing shows stay as they are, and the model with them
        bare, fitted = model, []
    problem = as_stated(PairedProblem.of(bare, data))
    for effect in fitted:
        problem = problem.with_effect_in(BOTH, effect, scales[effect.effect.kind, effect.site])
    problem = problem.refined(problem.begin())
    z = search(problem, rng, starts=numerics.RECALIBRATION_STARTS, note=silent)[0].z
    noise = (
        from_repeats(data, member_residuals(problem, z))
        or from_reading_errors(data)
        or of_sensor(data, mean_residuals(problem, z))
    )
    count = problem.size
    problem = problem.with_differences(range(count))
    return *_fitted(problem, np.insert(z, count, np.zeros(count)), noise), noise


def _fitted(problem: PairedProblem, z: FloatArray, noise: Noise) -> tuple[PairedProblem, FloatArray]:
    fitted = in_noise(problem, noise, z)
    return cast("PairedProblem", fitted.problem), fitted.z


def _library(problem: PairedProblem, z: FloatArray) -> list[Candidate]:
    """Return the differences of all variables, and the effects that the model has not, in either unit or both."""
    library: list[Candidate] = []
    for variable in _variables(problem):
        name = problem.priors.names[variable]
        label = _words(*_named(problem, variable))
        library.append(_Differs(_UnitName(name, name, "parameter", label), None, None, ((),), name))
    has = {(effect.effect.id, effect.site) for effect in (*problem.effects, *problem.model.effects)}
    for candidate in candidates(problem.model, site_scales(problem, z)):
        effect, site = candidate.name.effect, candidate.name.site
        if candidate.attached is None or (effect, site) in has:
            continue
        for unit in (BOTH, SECOND, FIRST):
            where = "both" if unit == BOTH else f"the {unit} alone"
            label = f"{candidate.name.words} in {where}"
            library.append(
                _InUnit(
                    _UnitName(effect, f"{site} in {where}", "effect", label),
                    candidate.attached,
                    candidate.scale,
                    candidate.starts,
                    unit,
                )
            )
    return library


def _variables(problem: PairedProblem) -> list[int]:
    """Return the variables that have a difference."""
    names = problem.priors.names
    return [variable for variable, name in enumerate(names) if difference_of(name) in names]


def _named(problem: Problem, variable: int) -> tuple[Name, str]:
    """Return what a variable is the size of, and its own name."""
    number, _, parameter = problem.priors.names[variable].partition(".")
    if not parameter:
        return Name(number, number, "parameter"), number
    effect = problem.effects[int(number)]
    return Name(effect.effect.id, effect.site), parameter


def _words(name: Name, parameter: str) -> str:
    return name.words if name.kind == "parameter" else f"{parameter} of {name.words}"


def _with_common(
    problem: PairedProblem, z: FloatArray, selection: Selection, common: Sequence[Chosen], noise: Noise
) -> tuple[PairedProblem, FloatArray, list[str]]:
    """Return the common model with the effects that both units have, and the names of their variables."""
    final, count = selection.final, problem.size
    at, sizes = count, list[FloatArray]()
    chosen = {cause.name for cause in common}
    for candidate in final.added:
        if candidate.name in chosen:
            sizes.append(final.z[at : at + candidate.variables])
            problem = cast("PairedProblem", candidate.added_to(problem))
        at += candidate.variables
    added = list(range(count, problem.size))
    start = np.insert(z, count, np.concatenate([*sizes, np.zeros(len(added))]))
    return *_fitted(problem.with_differences(added), start, noise), [problem.priors.names[k] for k in added]


def _differences(
    selection: Selection, noise: Noise, units: Units, rng: np.random.Generator, lacking: Sequence[str]
) -> tuple[UnitDifference, ...]:
    """Return what differs, what closes most first; then what both lack, what does not differ, and what is open."""
    final = selection.final
    problem, z = cast("PairedProblem", final.problem), final.z
    moved = scatter(Base.of(problem, z), noise, units, rng)
    values = problem.parameters(z)
    differing, taken = list[UnitDifference](), set[str]()
    for cause in selection.chosen:
        candidate, rivals = cause.candidate, _rivals(problem, cause)
        if isinstance(candidate, _Differs):
            taken.add(candidate.variable)
            variable = problem.priors.names.index(candidate.variable)
            change = _change(problem, z, moved, candidate.variable)
            value = float(values[problem.priors.free[variable]])
            sizes = value, value + change.value
            differing.append(UnitDifference(*_named(problem, variable), *sizes, change, "differs", rivals))
        elif isinstance(candidate, _InUnit):
            before = selection.reference.base.problem.size
            at = before + sum(other.variables for other in final.added[: final.added.index(candidate)])
            for variable in range(at, at + candidate.variables):
                size = _estimate(problem, z, moved, variable)
                sizes = (0.0, size.value) if candidate.unit == SECOND else (size.value, 0.0)
                if candidate.unit == FIRST:
                    size = ResampledNumber(-size.value, -size.high, -size.low, size.unit)
                differing.append(UnitDifference(*_named(problem, variable), *sizes, size, "differs", rivals))
    others = []
    for variable in _variables(problem):
        name = problem.priors.names[variable]
        if name in taken:
            continue
        released = problem.differing(name)
        end = minimise(released, z, tolerance=numerics.FIT_TOLERANCE, evaluations=numerics.FIT_EVALUATIONS)
        change = _change(released, end, scatter(Base.of(released, end), noise, units, rng), name)
        value = float(values[problem.priors.free[variable]])
        known = max(abs(change.low), abs(change.high)) <= _KNOWN_NOT_TO_DIFFER * abs(value)
        verdict = "both lack" if name in lacking else "same" if known else "open"
        others.append(
            UnitDifference(*_named(problem, variable), value, value + change.value, change, verdict)
        )
    order = ("both lack", "same", "open")
    return (*differing, *sorted(others, key=lambda difference: order.index(difference.verdict)))


def _rivals(problem: PairedProblem, cause: Chosen) -> tuple[str, ...]:
    """Return the names of the rivals of a cause, without richer forms of the effect whose size differs."""
    variable = getattr(cause.candidate, "variable", "")
    name = _named(problem, problem.priors.names.index(variable))[0] if variable else cause.name

    def is_richer(rival: Candidate) -> bool:
        attached = rival.attached
        return attached is not None and attached.site == name.site and name.effect in attached.effect.contains

    rivals = [entry.candidates[-1] for entry in cause.rivals]
    return tuple(str(rival.name) for rival in rivals if not is_richer(rival))


def _change(problem: PairedProblem, z: FloatArray, moved: FloatArray, name: str) -> ResampledNumber:
    """Return the difference of a variable between the units."""
    variable = problem.priors.names.index(name)
    unit = _unit(problem, variable)
    return _estimate(problem, z, moved, problem.priors.names.index(difference_of(name)), unit)


def _estimate(
    problem: PairedProblem, z: FloatArray, moved: FloatArray, variable: int, unit: str | None = None
) -> ResampledNumber:
    """Return a variable with its 95 % interval, given how it moves from experiment to experiment, (draws, size)."""
    scale = float(problem.priors.scale[variable])
    value = float(z[variable]) * scale
    low, high = np.percentile(moved[:, variable], [2.5, 97.5]) * scale
    unit = _unit(problem, variable) if unit is None else unit
    return ResampledNumber(value, value + min(float(low), 0.0), value + max(float(high), 0.0), unit)


def _unit(problem: Problem, variable: int) -> str:
    index = int(problem.priors.free[variable])
    if index < len(problem.model.parameters):
        return problem.model.parameters[index].unit
    number, _, parameter = problem.priors.names[variable].partition(".")
    return effect_units(problem.effects[int(number)], problem.model, problem.data)[parameter]


def _share(selection: Selection) -> float | None:
    """Return the part of what all differences could remove that the chosen ones remove; None without any."""
    if not selection.chosen:
        return None
    final, before = selection.final, selection.reference.base
    problem = cast("PairedProblem", final.problem)
    common = before.problem.with_noise(problem.noise)
    whole = common.squares(refit(common, before.z))
    everything = problem
    for variable in _variables(problem):
        everything = everything.differing(problem.priors.names[variable])
    removed = whole - problem.squares(final.z)
    more = problem.squares(final.z) - everything.squares(refit(everything, final.z))
    return float(removed / (removed + max(more, 0.0))) if removed > 0 else None


def _remarks(data: Dataset, first: int, second: int) -> list[str]:
    conditions = [
        {
            str({key: value for key, value in trial.condition.items() if key != UNIT})
            for trial in data.trials
            if trial.condition[UNIT] == unit
        }
        for unit in (FIRST, SECOND)
    ]
    remarks = []
    if not conditions[0] & conditions[1]:
        remarks.append(
            "the two have no condition in common: what the model lacks may look like a difference between them"
        )
    if min(first, second) < criteria.ENOUGH_UNITS:
        remarks.append(
            f"{first} and {second} trials: intervals rest on blocks of them, and do not show how trials differ"
        )
    return remarks
