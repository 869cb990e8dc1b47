"""The whole search on one dataset: recalibrate, measure the noise, try the library, choose the causes."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, Each, Note, one_by_one, silent
from labrun.gap import criteria
from labrun.gap.averaging import averaged
from labrun.gap.candidates import Candidate, candidates, site_scales, without
from labrun.gap.data_checks import require_informative, with_sound_clocks
from labrun.gap.diagnosis import Name
from labrun.gap.held_out import Excess, fitted_excess, held_out_excess, not_withheld
from labrun.gap.noise import Noise, from_residual
from labrun.gap.noise_threshold import full_strictness, noise_draws, noise_threshold
from labrun.gap.recalibration import (
    Recalibrated,
    bound_remarks,
    in_noise,
    member_residuals,
    recalibrate,
    unsearched,
)
from labrun.gap.screening import Base, ends_of, screen_all, survey
from labrun.gap.selection import Selection, Selector
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
    draws
        Noise of the averaged trials, whitened, that set the threshold.
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
    draws: list[list[FloatArray]]
    raw: Excess
    recalibrated: Excess
    held_out: Excess
    selection: Selection
    full_guard: bool

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

    Raises
    ------
    RecordingError, FitError, ModelError, RequestError
        Data or model that do not allow a diagnosis, with what to do.
    """
    require_informative(dataset)
    clocks = with_sound_clocks(dataset)
    data = averaged(clocks.dataset, model)
    recalibration = recalibrate(model, data, rng, note)
    unfinished = unsearched(recalibration.problem, recalibration.z)
    scales = site_scales(recalibration.problem, recalibration.z)
    every = candidates(recalibration.problem.model, scales, withhold)
    known: dict[Name, FloatArray] = {}
    strictness = 1.0
    if recalibration.noise.basis == "residual":
        recalibration, known = _without_repeats(recalibration, every, note, each)
        strictness = criteria.UNREPEATED_STRICTNESS
    problem, noise, z = recalibration.problem, recalibration.noise, recalibration.z
    note(f"trying {len(every)} candidates")
    draws = noise_draws(problem, noise, rng)
    held_out = held_out_excess(problem, z, noise)
    base = Base.of(problem, z)
    if full_guard:
        note("running the whole search on noise alone, for the guard")
        linear = noise_threshold(base, each(lambda one: survey(base, one), every), draws)
        strictness *= full_strictness(base, every, noise, linear, rng, each)
    selector = Selector(base, every, noise, draws, held_out, strictness, known, each, note)
    return Search(
        clocks.dataset,
        data,
        (*clocks.limitations, *unfinished, *_without(withhold)),
        clocks.notes,
        recalibration,
        every,
        draws,
        fitted_excess(problem, recalibration.raw, noise),
        fitted_excess(problem, z, noise),
        held_out,
        selector.select(),
        full_guard,
    )


def _without(withhold: Collection[str]) -> tuple[str, ...]:
    if not withhold:
        return ()
    return (f"The library was without {', '.join(sorted(withhold))}, as asked: such a cause is not found.",)


def _without_repeats(
    recalibration: Recalibrated, every: list[Candidate], note: Note, each: Each
) -> tuple[Recalibrated, dict[Name, FloatArray]]:
    """Take as noise what the best few candidates together leave: without repeats nothing else tells it from the gap.

    Its colour is believed of that remainder only: where the model is wrong, the gap has a colour of its own. Returned
    with the sizes at which fits of candidates beside the recalibrated model ended.
    """
    units = recalibration.problem.data
    note("no repeats: telling noise from gap by what the best candidates together leave")
    base = Base.of(recalibration.problem, recalibration.z)
    first, known = dict[Name, FloatArray](), dict[Name, FloatArray]()
    for _ in range(criteria.MOST_CAUSES):
        rest = without(every, {one.name for one in base.added})
        surveys = each(lambda one, base=base: survey(base, one), rest)  # type: ignore[misc]
        screened = screen_all(
            base,
            surveys,
            each=each,
            worth=criteria.REPLACED_AS_GOOD,
            beside_best=criteria.REPLACED_PROMISE,
            known=known,
        )
        known |= ends_of(screened)
        first = first or dict(known)
        best = min(screened, key=lambda one: one.squares, default=None)
        if best is None or best.squares > criteria.REPLACED_WORTH * base.squares:
            break
        base = Base.of(best.problem, best.z, (*base.added, best.candidate))
    noise = from_residual(units, member_residuals(base.problem, base.z))
    return in_noise(recalibration.problem, noise, recalibration.z), first
