"""The whole search on one dataset: recalibrate, measure the noise, try the library, choose the causes."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, Deviation, Each, Note, Problem, one_by_one, silent
from labrun.gap import criteria
from labrun.gap.averaging import averaged, without_crowding
from labrun.gap.candidates import Candidate, candidates, site_scales, untried
from labrun.gap.data_checks import CheckedTrials, require_informative, with_sound_clocks
from labrun.gap.diagnosis import Name
from labrun.gap.evidence import Units, UnseenError, error_of
from labrun.gap.held_out import (
    ExcessResidual,
    fitted_excess,
    floor_of,
    mean_residuals,
    not_withheld,
)
from labrun.gap.lines import growth_in_wells
from labrun.gap.noise import Noise
from labrun.gap.on_course import kept_in_wells, kept_on_course
from labrun.gap.progress import Progress
from labrun.gap.recalibration import (
    Recalibrated,
    bound_remarks,
    in_noise,
    recalibrate,
    replaced_terms,
    settled_in_own_units,
    unit_remarks,
    unsearched,
    with_deviations,
)
from labrun.gap.screening import Base
from labrun.gap.selection import Selection, Selector
from labrun.gap.trial_wise import (
    ALSO_SHAPES,
    beginning_s,
    deviations_without_repeats,
    outputs_without_common_zero,
    simulated_changes,
)
from labrun.models import Model

_DEVIATION_NEARLY_ALL = 0.8
"""Share of what is left that deviations have to remove once everything is fitted, where causes look like them."""


@dataclass(frozen=True)
class Search:
    """Everything that was found, before it is put into words.

    Attributes
    ----------
    dataset, data
        The trials that were looked at, and the same with repeats averaged.
    limitations, notes
        What to know about them, in sentences.
    units
        Units of evidence.
    floor
        Systematic residual that noise alone leaves at most, in units of one trial's noise; 0 where nothing tells it.
    stated
        Errors of the stated parameters, which have seen nothing.
    recalibrated
        What recalibration leaves of the data it has seen.
    """

    dataset: Dataset
    data: Dataset
    limitations: tuple[str, ...]
    notes: tuple[str, ...]
    recalibration: Recalibrated
    candidates: list[Candidate]
    units: Units
    floor: float
    stated: UnseenError
    recalibrated: ExcessResidual
    selection: Selection
    withhold: Collection[str] = ()

    @property
    def model(self) -> Model:
        """The model that was searched for."""
        return self.recalibration.problem.model

    @property
    def noise(self) -> Noise:
        """The noise floor."""
        return self.recalibration.noise

    @property
    def is_quiet(self) -> bool:
        """Whether known noise leaves as much as the recalibrated model, or nothing was asked."""
        return not self.candidates or (self.noise.known and self.recalibrated.gap <= self.floor)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What to know about the recalibration and the causes, and which candidates were not tried."""
        problem, final = self.recalibration.problem, self.selection.final
        first = self.selection.first
        tried = set() if first is None else {entry.candidate.name for entry in first.screened}
        left_out = (
            []
            if first is None
            else [candidate.name for candidate in self.candidates if candidate.name not in tried]
        )
        return (
            *bound_remarks(problem, self.recalibration.z),
            *replaced_terms(problem, self.recalibration.z, final.z),
            *untried(problem.model, self.withhold),
            *not_withheld(final.problem, final.z, final.nuisance.jacobian),
            *(f"effect {name} gives no finite numbers at any size: it was not tried" for name in left_out),
        )


def search_causes(
    dataset: Dataset,
    model: Model,
    rng: np.random.Generator,
    *,
    withhold: Collection[str] = (),
    brisk: bool = False,
    least_gap: float = 0.0,
    deadline_s: float = np.inf,
    each: Each = one_by_one,
    note: Note = silent,
) -> Search:
    """Search the library for what a model lacks: recalibration, noise, candidates, threshold, withheld conditions.

    Parameters
    ----------
    withhold
        Ids of effects that the library is to be without.
    brisk, least_gap
        See `labrun.gap.Options`.
    deadline_s
        By `time.perf_counter`: then the search ends with the best answer so far.

    Raises
    ------
    RecordingError, FitError, ModelError, RequestError
        Data or model that do not allow a diagnosis, with what to do.
    """
    require_informative(dataset)
    clocks = with_sound_clocks(dataset)
    data = averaged(clocks.dataset, model)
    followed, model, message = kept_on_course(clocks.dataset, model)
    if message:
        note("the model is unstable in open loop: keeping it on course by what was measured")
        clocks = replace(clocks, dataset=followed, limitations=(message, *clocks.limitations))
        data = averaged(followed, model)
    if model.states:
        data = without_crowding(data)
    first = recalibrate(model, data, rng, note, each)
    asked = _Asked(clocks, data, withhold, brisk, least_gap, rng, each, note, deadline_s)
    search = _searched(asked, first)
    if not search.candidates:  # what recalibration leaves is no gap here, or nothing moves
        return search
    search = _with_own_deviations(asked, first, search)
    return _in_wells(asked, search) or search


def _in_wells(asked: "_Asked", search: Search) -> Search | None:
    """Return the search once more on what an observer keeps in the wells of a force that comes back along a coordinate.

    Only where what is left plainly comes back so, and where the search finds that force then.
    """
    final = search.selection.final
    if search.selection.error.in_noise < criteria.LARGE_REMAINDER or search.selection.stopped:
        return None
    growth = max(
        (growth_in_wells(final.problem, final.z, candidate) for candidate in search.candidates), default=0.0
    )
    held = kept_in_wells(asked.clocks.dataset, search.model, growth) if growth > 0.0 else None
    if held is None:
        return None
    asked.note(
        "what is left comes back along the coordinate: keeping the model in its wells by what was measured"
    )
    dataset, model, message = held
    clocks = replace(asked.clocks, dataset=dataset, limitations=(message, *asked.clocks.limitations))
    data = without_crowding(averaged(dataset, model))
    with_clocks = replace(asked, clocks=clocks, data=data)
    first = recalibrate(model, data, asked.rng, asked.note, asked.each)
    again = _with_own_deviations(with_clocks, first, _searched(with_clocks, first))
    attached = [cause.candidate.attached for cause in again.selection.chosen]
    return again if any(effect is not None and effect.effect.periodic for effect in attached) else None


def _with_own_deviations(asked: "_Asked", first: Recalibrated, search: Search) -> Search:
    """Return the search once more beside what differs by trial, where nothing was repeated and something does.

    Causes come first: what they explain of the differences between trials is theirs. If none of them stands beside the
    deviations, these are found again without them.
    """
    if first.noise.known or search.selection.stopped:
        return search
    final = search.selection.final
    for problem, z in ((final.problem, final.z), (first.problem, first.z)):
        likely = deviations_without_repeats(
            asked.data,
            mean_residuals(problem, z),
            problem.simulated(z),
            simulated_changes(problem, z),
            beginning_s(problem),
        )
        deviations = _sufficient_deviations(problem, z, first.noise, likely)
        if not deviations:
            break
        asked.note("taking apart what differs from trial to trial, and looking for causes beside it")
        extended, start = with_deviations(first.problem, first.z, deviations)
        zeros = [
            asked.data.outputs[output].name
            for output in outputs_without_common_zero(mean_residuals(problem, z), deviations)
        ]
        again = _searched(asked, in_noise(extended, first.noise, start), zeros, search.selection.judged)
        if again.selection.chosen or not search.selection.chosen:
            return again
        search = again
    return search


def _sufficient_deviations(
    problem: Problem, z: FloatArray, noise: Noise, likely: Sequence[tuple[Deviation, ...]]
) -> tuple[Deviation, ...]:
    """Return the deviations that leave least once everything is fitted with them; none if that is not next to nothing.

    Of those that no cause looks like, nothing is asked.
    """
    if not likely or not any(deviation.kind in ALSO_SHAPES for deviation in likely[0]):
        return likely[0] if likely else ()
    rests = [_remaining_share(problem, z, noise, deviations) for deviations in likely]
    least = int(np.argmin(rests))
    return likely[least] if rests[least] <= 1.0 - _DEVIATION_NEARLY_ALL else ()


def _remaining_share(problem: Problem, z: FloatArray, noise: Noise, deviations: Sequence[Deviation]) -> float:
    """Return the part that is left beside deviations, in units of what is left then: else they are taken for noise."""
    fitted = settled_in_own_units(noise, *with_deviations(problem, z, deviations))
    after, before = mean_residuals(*fitted), mean_residuals(problem, z)
    remaining, all_of_it = (
        np.mean(np.square(np.concatenate(residuals)), axis=0) for residuals in (after, before)
    )
    return float(np.mean(remaining / np.where(all_of_it > 0, all_of_it, 1.0)))


@dataclass(frozen=True)
class _Asked:
    """What a search is asked, whichever way the residual is looked at."""

    clocks: CheckedTrials
    data: Dataset
    withhold: Collection[str]
    brisk: bool
    least_gap: float
    rng: np.random.Generator
    each: Each
    note: Note
    deadline_s: float


def _searched(
    asked: _Asked,
    recalibration: Recalibrated,
    zeros: Collection[str] = (),
    among: Collection[Name] | None = None,
) -> Search:
    """Search beside a recalibration.

    Parameters
    ----------
    zeros
        Outputs whose zeros are set anew in each trial: their bias is no cause.
    among
        Names of the candidates to search among; the whole library if None.
    """
    problem, noise, z = recalibration.problem, recalibration.noise, recalibration.z
    recalibrated = fitted_excess(problem, z, noise)
    scales = site_scales(problem, z) if recalibrated.gap >= asked.least_gap else None
    every = [
        candidate
        for candidate in (() if scales is None else candidates(problem.model, scales, asked.withhold))
        if not (candidate.name.effect == "bias" and candidate.name.site in zeros)
        and (among is None or candidate.name in among)
    ]
    asked.note(f"trying {len(every)} candidates")
    base = Base.of(problem, z, brisk=asked.brisk)
    floor = floor_of(problem.data, noise, asked.rng) if noise.known else 0.0
    units = Units.of(problem.data, mean_residuals(problem, z))
    progress = Progress(asked.each, asked.note, asked.deadline_s)
    selector = Selector(base, every, noise, units, floor, asked.rng, progress)
    limitations = (
        *unit_remarks(problem, recalibration.raw),
        *asked.clocks.limitations,
        *unsearched(problem, z),
        *_without(asked.withhold),
    )
    return Search(
        asked.clocks.dataset,
        asked.data,
        limitations,
        asked.clocks.notes,
        recalibration,
        every,
        units,
        floor,
        error_of(problem.data, noise, units, mean_residuals(problem, recalibration.raw)),
        recalibrated,
        selector.select(),
        asked.withhold,
    )


def _without(withhold: Collection[str]) -> tuple[str, ...]:
    if not withhold:
        return ()
    return (f"The library was without {', '.join(sorted(withhold))}, as asked: such a cause is not found.",)
