"""Diagnose trials against a model."""

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from labrun.fit import Dataset, Note, silent, workers
from labrun.gap.conclusion import conclude
from labrun.gap.diagnosis import Diagnosis
from labrun.gap.pipeline import search_causes
from labrun.gap.rest_law import explain_rest
from labrun.models import Model


@dataclass(frozen=True)
class Question:
    """Data, the model they are held against, and which recorded channel is which of its inputs and outputs."""

    dataset: Dataset
    model: Model
    signals: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Options:
    """How to diagnose.

    Attributes
    ----------
    withhold
        Ids of effects that the library is to be without.
    places
        Whether to look for where the gap is; the search for causes does not need it.
    brisk
        Whether to save time where many models of one joint are diagnosed: derivatives by the model's own variables are
        carried over from fit to fit, and what is ruled out is bounded beside no cause. The shape of an effect may be
        missed so, as that of a servo's friction was on a test stand.
    least_gap
        What recalibration leaves, in units of the noise, below which no cause is looked for.
    explain_rest
        Whether to propose a law for what the causes leave.
    within_s
        Time after which the search ends with the best answer so far.
    """

    seed: int = 0
    withhold: Collection[str] = ()
    workers: int = 1
    places: bool = True
    brisk: bool = False
    least_gap: float = 0.0
    explain_rest: bool = False
    within_s: float = float("inf")


def diagnose_dataset(
    dataset: Dataset,
    model: Model,
    options: Options | None = None,
    *,
    note: Note = silent,
    began: float | None = None,
) -> Diagnosis:
    """Say where a model and measurements differ, which cause explains it, and how far.

    Parameters
    ----------
    began
        When the work began that the diagnosis tells the duration of, by `time.perf_counter`; now if None.
    """
    options = options or Options()
    start = time.perf_counter() if began is None else began
    rng = np.random.default_rng(options.seed)
    with workers(options.workers) as each:
        search = search_causes(
            dataset,
            model,
            rng,
            withhold=options.withhold,
            brisk=options.brisk,
            least_gap=options.least_gap,
            deadline_s=start + options.within_s,
            each=each,
            note=note,
        )
        diagnosis = conclude(
            search,
            rng,
            seed=options.seed,
            elapsed_s=lambda: time.perf_counter() - start,
            places=options.places,
            note=note,
        )
        if not options.explain_rest:
            return diagnosis
        final = search.selection.final
        law = explain_rest(final.problem, final.z, search.noise, rng, note=note)
        return replace(
            diagnosis, law=law, notes=(*diagnosis.notes, *(() if law is None else (law.sentence,)))
        )
