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
from labrun.gap.held_out import (
    ExcessResidual,
    fitted_excess,
    floor_of,
    held_out_excess,
    mean_residuals,
    not_withheld,
)
from labrun.gap.lines import growth_in_wells
from labrun.gap.noise import Noise
from labrun.gap.noise_threshold import Null, full_strictness, noise_threshold
from labrun.gap.on_course import kept_in_wells, kept_on_course
from labrun.gap.recalibration import (
    Recalibrated,
    bound_remarks,
    fitted_in_own_units,
    in_noise,
    recalibrate,
    settled_in_own_units,
    unit_remarks,
    unsearched,
    with_deviations,
)
from labrun.gap.screening import Base, survey
from labrun.gap.selection import Selection, Selector
from labrun.gap.trial_wise import ALSO_SHAPES, beginning_s, found_alone, set_anew, simulated_changes
from labrun.models import Model


@dataclass(frozen=True)
class Search:
    """Everything that was found, before it is put into words.

    Attributes
    ----------
    dataset, data
        The trials that were looked at, and the same with repeats averaged.
    limitations, notes
        What to know about them, in sentences.
    null
        What candidates had to beat.
    raw, recalibrated
        Excess with the stated and the recalibrated parameters; `held_out` that of recalibrations that did not
        see the condition.
    """

    dataset: Dataset
    data: Dataset
    limitations: tuple[str, ...]
    notes: tuple[str, ...]
    recalibration: Recalibrated
    candidates: list[Candidate]
    null: Null
    raw: ExcessResidual
    recalibrated: ExcessResidual
    held_out: ExcessResidual
    selection: Selection
    full_guard: bool
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
    def remarks(self) -> tuple[str, ...]:
        """What to know about the recalibration and the causes, and which candidates were not tried."""
        problem, final = self.recalibration.problem, self.selection.final
        tried = {one.candidate.name for one in self.selection.rounds[0].screened}
        left_out = [one.name for one in self.candidates if one.name not in tried]
        return (
            *bound_remarks(problem, self.recalibration.z),
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
    full_guard: bool = False,
    brisk: bool = False,
    least_gap: float = 0.0,
    each: Each = one_by_one,
    note: Note = silent,
) -> Search:
    """Search the library for what a model lacks: recalibration, noise, candidates, threshold, withheld conditions.

    Parameters
    ----------
    withhold
        Ids of effects that the library is to be without.
    full_guard
        Run the whole search, with all its fits, on noise alone, too.
    brisk, least_gap
        See `labrun.gap.Options`.

    Raises
    ------
    RecordingError, FitError, ModelError, RequestError
        Data or model that do not allow a diagnosis, with what to do.
    """
    require_informative(dataset)
    clocks = with_sound_clocks(dataset)
    data = averaged(clocks.dataset, model)
    followed, model, said = kept_on_course(clocks.dataset, model)
    if said:
        note("the model is unstable in open loop: keeping it on course by what was measured")
        clocks = replace(clocks, dataset=followed, limitations=(said, *clocks.limitations))
        data = averaged(followed, model)
    if model.states:
        data = without_crowding(data)
    first = recalibrate(model, data, rng, note, each)
    asked = _Asked(clocks, data, withhold, full_guard, brisk, least_gap, rng, each, note)
    found = _searched(asked, first)
    if not found.candidates:  # what recalibration leaves is no gap here, or nothing moves
        return found
    if not first.noise.known and not found.selection.chosen:
        # the phase of a free swing drifts, so that nothing is linear but what its own past does not predict
        note("nothing explains the residual: looking at what its own past does not predict")
        noise = replace(first.noise, innovations=True)
        again = _searched(asked, in_noise(first.problem, noise, first.z))
        found = _fitted_to_motion(again, first.noise) if again.selection.chosen else found
    found = _with_own_deviations(asked, first, found)
    return _in_wells(asked, found) or found


def _in_wells(asked: "_Asked", found: Search) -> Search | None:
    """Return the search once more on what an observer keeps in the wells of a force that comes back along a coordinate.

    Only where what is left plainly comes back so, and where the search finds that force then.
    """
    final = found.selection.final
    if found.selection.held_out.gap < criteria.LARGE_REMAINDER:
        return None
    growth = max((growth_in_wells(final.problem, final.z, one) for one in found.candidates), default=0.0)
    held = kept_in_wells(asked.clocks.dataset, found.model, growth) if growth > 0.0 else None
    if held is None:
        return None
    asked.note(
        "what is left comes back along the coordinate: keeping the model in its wells by what was measured"
    )
    dataset, model, said = held
    clocks = replace(asked.clocks, dataset=dataset, limitations=(said, *asked.clocks.limitations))
    data = without_crowding(averaged(dataset, model))
    beside = replace(asked, clocks=clocks, data=data)
    first = recalibrate(model, data, asked.rng, asked.note, asked.each)
    again = _with_own_deviations(beside, first, _searched(beside, first))
    attached = [one.rated.candidate.attached for one in again.selection.chosen]
    return again if any(one is not None and one.effect.periodic for one in attached) else None


def _with_own_deviations(asked: "_Asked", first: Recalibrated, found: Search) -> Search:
    """Return the search once more beside what differs by trial, where nothing was repeated and something does.

    Causes come first: what they explain of the differences between trials is theirs. If none of them stands beside the
    deviations, these are found again without them.
    """
    if first.noise.known:
        return found
    final = found.selection.final
    for problem, z in ((final.problem, final.z), (first.problem, first.z)):
        likely = found_alone(
            asked.data,
            mean_residuals(problem, z),
            problem.simulated(z),
            simulated_changes(problem, z),
            beginning_s(problem),
        )
        deviations = _that_make_up_what_is_left(problem, z, first.noise, likely)
        if not deviations:
            break
        asked.note("taking apart what differs from trial to trial, and looking for causes beside it")
        beside, start = with_deviations(first.problem, first.z, deviations)
        zeros = [asked.data.outputs[one].name for one in set_anew(mean_residuals(problem, z), deviations)]
        again = _searched(asked, in_noise(beside, first.noise, start), zeros)
        if again.selection.chosen or not found.selection.chosen:
            return again
        found = again
    return found


def _that_make_up_what_is_left(
    problem: Problem, z: FloatArray, noise: Noise, likely: Sequence[tuple[Deviation, ...]]
) -> tuple[Deviation, ...]:
    """Return the deviations that leave least once everything is fitted with them; none if that is not next to nothing.

    Of those that no cause looks like, nothing is asked.
    """
    if not likely or not any(one.kind in ALSO_SHAPES for one in likely[0]):
        return likely[0] if likely else ()
    left = [_left_beside(problem, z, noise, one) for one in likely]
    least = int(np.argmin(left))
    return likely[least] if left[least] <= 1.0 - criteria.DEVIATION_NEARLY_ALL else ()


def _left_beside(problem: Problem, z: FloatArray, noise: Noise, deviations: Sequence[Deviation]) -> float:
    """Return the part that is left beside deviations, in units of what is left then: else they are taken for noise."""
    fitted = settled_in_own_units(noise, *with_deviations(problem, z, deviations))
    after, before = mean_residuals(*fitted), mean_residuals(problem, z)
    left, all_of_it = (np.mean(np.square(np.concatenate(one)), axis=0) for one in (after, before))
    return float(np.mean(left / np.where(all_of_it > 0, all_of_it, 1.0)))


def _fitted_to_motion(search: Search, noise: Noise) -> Search:
    """Return a search whose causes are fitted once more to the motion itself, which is what a model has to predict.

    What its own past does not predict tells which causes there are; of their sizes it says less than the motion.
    """
    final = search.selection.final
    problem, z = fitted_in_own_units(noise, final.problem, final.z)
    final = Base.of(problem, z, final.added, brisk=final.brisk)
    selection = replace(search.selection, final=final, held_out=held_out_excess(problem, z, noise))
    return replace(search, selection=selection)


@dataclass(frozen=True)
class _Asked:
    """What a search is asked, whichever way the residual is looked at."""

    clocks: CheckedTrials
    data: Dataset
    withhold: Collection[str]
    full_guard: bool
    brisk: bool
    least_gap: float
    rng: np.random.Generator
    each: Each
    note: Note


def _searched(asked: _Asked, recalibration: Recalibrated, zeros: Collection[str] = ()) -> Search:
    """Search beside a recalibration; a bias of outputs whose zeros are set anew in each trial is no cause."""
    problem, noise, z = recalibration.problem, recalibration.noise, recalibration.z
    recalibrated = fitted_excess(problem, z, noise)
    scales = site_scales(problem, z) if recalibrated.gap >= asked.least_gap else None
    every = [
        one
        for one in (() if scales is None else candidates(problem.model, scales, asked.withhold))
        if not (one.name.effect == "bias" and one.name.site in zeros)
    ]
    asked.note(f"trying {len(every)} candidates")
    null = Null.of(problem, noise, asked.rng)
    held_out = held_out_excess(problem, z, noise)
    base = Base.of(problem, z, brisk=asked.brisk)
    strictness = 1.0
    if asked.full_guard:
        asked.note("running the whole search on noise alone, for the guard")
        linear = noise_threshold(base, asked.each(lambda one: survey(base, one), every), null)
        strictness = full_strictness(base, every, null, linear, asked.rng, asked.each)
    small = criteria.SMALL_GAP
    if noise.known:
        floor = floor_of(problem.data, noise, np.random.default_rng(null.seed))
        small = criteria.BEYOND_FLOOR * floor
    selector = Selector(base, every, noise, null, held_out, strictness, asked.each, asked.note, small)
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
        null,
        fitted_excess(problem, recalibration.raw, noise),
        recalibrated,
        held_out,
        selector.select(),
        asked.full_guard,
        asked.withhold,
    )


def _without(withhold: Collection[str]) -> tuple[str, ...]:
    if not withhold:
        return ()
    return (f"The library was without {', '.join(sorted(withhold))}, as asked: such a cause is not found.",)
