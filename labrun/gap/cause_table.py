"""The causes with their sizes, and what became of every candidate."""

import numpy as np

from labrun.estimate import significant
from labrun.fit import Dataset, Problem
from labrun.gap import criteria
from labrun.gap.bounds import upper_bounds
from labrun.gap.candidates import Candidate, family
from labrun.gap.diagnosis import CandidateVerdict, Cause, Name, RatedCandidate, ResampledNumber
from labrun.gap.intervals import effect_units, parameter_value, reference_values, scatter, values_of
from labrun.gap.pipeline import Search
from labrun.gap.screening import Base, Screened
from labrun.gap.selection import Chosen, Table

_AT_BOUND = 1e-3
"""Part of what is searched within which a size stands at its bound."""


def causes_of(search: Search, dataset: Dataset, rng: np.random.Generator) -> tuple[Cause, ...]:
    """Return the causes with sizes and 95 % intervals from the final fit."""
    selection, final = search.selection, search.selection.final
    if not selection.chosen:
        return ()
    moved = scatter(final, search.noise, search.units, rng)
    model, causes = final.problem.model, []
    for chosen in selection.chosen:
        name, refers_to = chosen.name, dict[str, tuple[float, str]]()
        if name.kind == "parameter":
            values = parameter_value(final.problem, final.z, name.effect, moved, model)
            remark = _parameter_remark(final.problem, name.effect, values[name.effect].value)
        else:
            index = _index_of(search, name)
            values = values_of(final.problem, final.z, index, moved, model, dataset)
            refers_to = reference_values(final.problem, final.z, index, model, dataset)
            remark = "; ".join(
                filter(None, (_bound_remark(search, index), _caution(chosen), _kinship(chosen)))
            )
        causes.append(
            Cause(
                name,
                chosen.confidence,
                values,
                chosen.closes,
                chosen.returns,
                chosen.rival_names,
                refers_to,
                remark,
            )
        )
    return tuple(causes)


def _parameter_remark(problem: Problem, name: str, value: float) -> str:
    stated = next(parameter.value for parameter in problem.model.parameters if parameter.name == name)
    if not stated:
        return ""
    ratio = value / stated
    return f"{ratio:.3g} times the stated value" + (": its sign is reversed" if ratio < 0.0 else "")


def _kinship(chosen: Chosen) -> str:
    """Return the family that a cause shares with a rival, as a remark."""
    shared = next(filter(None, (family(chosen.name, rival) for rival in chosen.rival_names)), "")
    return f"{shared}: correcting one of these forms corrects the other" if shared else ""


def _caution(chosen: Chosen) -> str:
    attached = chosen.candidate.attached
    return "" if attached is None else attached.effect.caution


def candidate_table(
    search: Search, dataset: Dataset, causes: tuple[Cause, ...]
) -> tuple[RatedCandidate, ...]:
    """Return what became of every candidate: causes first, then rivals, then by what each closes alone."""
    selection = search.selection
    first, last = selection.first, selection.last or selection.first
    if first is None or last is None:
        return ()
    chosen = {cause.name: cause for cause in causes}
    rivals: dict[Name, list[Name]] = {}
    for cause in causes:
        for rival in cause.rivals:
            rivals.setdefault(rival, []).append(cause.name)
    alone = {
        first.added(entry).name: (
            1.0 - entry.error.in_noise / first.start.error.in_noise
            if first.start.error.in_noise > 0.0
            else 0.0
        )
        for entry in first.extended
    }
    rows = []
    for candidate in search.candidates:
        name = candidate.name
        table = last if last.find(name) else first
        screened = table.find(name)
        if screened is None and name not in chosen:
            continue
        status = _status(screened, table, name, chosen, rivals)
        bounds: dict[str, ResampledNumber] = {}
        if status == "not-needed" and screened is not None and candidate.attached is not None:
            bounds = upper_bounds(
                screened, table.start.base, effect_units(candidate.attached, search.model, dataset)
            )
            status = "excluded" if bounds else status
        rows.append(
            RatedCandidate(
                name,
                status,
                alone.get(name),
                chosen[name].values if name in chosen else {},
                bounds,
                chosen[name].indistinguishable_from if name in chosen else tuple(rivals.get(name, ())),
                _remark(candidate, status, search, dataset),
            )
        )
    rank = {"cause": 0, "rival": 1, "not-needed": 2, "excluded": 2, "not-visible": 3}
    return tuple(sorted(rows, key=lambda row: (rank[row.verdict], -(row.closes or 0.0))))


def _status(
    screened: Screened | None,
    table: Table,
    name: Name,
    chosen: dict[Name, Cause],
    rivals: dict[Name, list[Name]],
) -> CandidateVerdict:
    if name in chosen or screened is None:
        return "cause"
    if name in rivals:
        return "rival"
    changes = max(screened.visible**2, screened.gain)
    if name.kind == "effect" and changes < _least_change(table.start.base):
        return "not-visible"
    return "not-needed"


def _least_change(base: Base) -> float:
    """Return the change of the sum of squares that would move the log error by the practical margin."""
    return base.squares * float(np.expm1(criteria.MARGIN))


def _remark(candidate: Candidate, status: CandidateVerdict, search: Search, dataset: Dataset) -> str:
    if status == "not-visible":
        return "what it changes at the sizes tried is nearly all imitated by parameters"
    return _searched(candidate, search, dataset) if status == "excluded" else ""


def _searched(candidate: Candidate, search: Search, dataset: Dataset) -> str:
    """Return the range of sizes that were tried: beyond it nothing is ruled out."""
    attached, scale = candidate.attached, candidate.scale
    if attached is None or scale is None:
        return ""
    units = effect_units(attached, search.model, dataset)
    ranges = [
        f"{parameter.name} {significant(low)} to {significant(high)} {units[parameter.name]}".removesuffix(
            " 1"
        )
        for parameter in attached.effect.parameters
        if not parameter.held
        for low, high in [parameter.bounds(scale)]
    ]
    return f"searched: {', '.join(ranges)}"


def _index_of(search: Search, name: Name) -> int:
    effects = search.selection.final.problem.effects
    kinds = [(effect.effect.id, effect.site) for effect in effects]
    return kinds.index((name.effect, name.site))


def _bound_remark(search: Search, index: int) -> str:
    final = search.selection.final
    variable = final.problem.size - sum(
        not parameter.held for other in final.problem.effects[index:] for parameter in other.effect.parameters
    )
    at_bounds = []
    for parameter in final.problem.effects[index].effect.parameters:
        if parameter.held:
            continue
        within = np.array([parameter.lower, final.z[variable], parameter.upper])
        if parameter.lower > 0.0:  # what spans decades is searched in proportion
            within = np.log(within)
        low, value, high = within
        if min(abs(value - low), abs(high - value)) < _AT_BOUND * (high - low):
            at_bounds.append(parameter.name)
        variable += 1
    if not at_bounds:
        return ""
    return f"{' and '.join(at_bounds)} ended at a bound of what is searched: take it as a direction, not as a size"
