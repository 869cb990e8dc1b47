"""How far a model predicts a recording that nobody fitted, by prediction horizon, beside the model it came from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from labrun.arrays import FloatArray
from labrun.errors import FitError, RequestError
from labrun.fit import (
    FEW_TRIALS,
    FEWEST_SAMPLES,
    Dataset,
    FitTrial,
    Note,
    Problem,
    minimise,
    resample_trials,
    silent,
)
from labrun.gap.diagnosis import ResampledNumber
from labrun.gap.recalibration import stated
from labrun.models import Model
from labrun.notebook import as_reported

_FRESH_HORIZONS_S = (0.1, 0.5, 2.0)
"""How far ahead is predicted where nobody says."""
_FRESH_STARTS = 40
"""Predictions of one trial, spread evenly over it."""
_FRESH_PIECES = 8
"""Pieces that a single trial is resampled in."""


@dataclass(frozen=True)
class Prediction:
    """The error of one output at one horizon.

    Attributes
    ----------
    horizon_s
        How far ahead; None over the whole trial, from its beginning.
    error, before
        Root mean square of measured minus predicted, of the model and of the one it came from, with 95 % intervals.
    ratio
        The first over the second, the trials resampled together.
    predictions
        How many there are.
    """

    output: str
    horizon_s: float | None
    error: ResampledNumber
    before: ResampledNumber | None
    ratio: ResampledNumber | None
    predictions: int


@dataclass(frozen=True)
class FreshTest:
    """A model on fresh data.

    Attributes
    ----------
    before
        Name of the model it came from; "" where there is none.
    """

    model: str
    before: str
    data: str
    trials: int
    warm_up_samples: int
    predictions: tuple[Prediction, ...]
    notes: tuple[str, ...]

    def _repr_html_(self) -> str:
        return as_reported("fresh_text", self)

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap test --json`` prints."""
        return {
            "model": self.model,
            "before": self.before or None,
            "data": self.data,
            "trials": self.trials,
            "warm_up_samples": self.warm_up_samples,
            "predictions": [
                {
                    "output": prediction.output,
                    "horizon_s": prediction.horizon_s,
                    "error": prediction.error.to_json(),
                    "before": prediction.before and prediction.before.to_json(),
                    "ratio": prediction.ratio and prediction.ratio.to_json(),
                    "predictions": prediction.predictions,
                }
                for prediction in self.predictions
            ],
            "notes": list(self.notes),
        }


def predict_fresh(
    model: Model,
    dataset: Dataset,
    rng: np.random.Generator,
    *,
    before: Model | None = None,
    horizons_s: Sequence[float] | None = None,
    note: Note = silent,
) -> FreshTest:
    """Predict fresh trials and return the error by horizon, for a model and the one it came from.

    Every prediction begins at states that are fitted to the 25 samples before it, and to nothing else; parameters and
    effects stay as they are. Over the whole trial only what the model says is free, or read from the first samples, is
    fitted.

    Parameters
    ----------
    before
        The model it came from.
    horizons_s
        How far ahead; of 0.1, 0.5 and 2 s those that the trials are long enough for if None.

    Raises
    ------
    RequestError
        A horizon that is not positive, or that no trial is long enough for.
    FitError
        The model leaves the finite numbers.
    """
    models = [model] if before is None else [model, before]
    notes: list[str] = []
    horizons = _horizons(dataset, horizons_s, notes) if model.states else ()
    if not model.states:
        notes.append("the model has no states: it predicts as well however far ahead")
    ahead = [_ahead(m, dataset, horizons, notes, note) for m in models] if horizons else []
    note("simulating whole trials")
    whole = [_whole(m, dataset) for m in models]
    predictions: list[Prediction] = []
    for column, output in enumerate(dataset.outputs):
        for index, horizon_s in enumerate(horizons):
            errors = [[trial[:, index, column] for trial in of_model] for of_model in ahead]
            predictions.append(_prediction(output.name, output.unit, horizon_s, errors, rng))
        errors = [[trial[:, column] for trial in of_model] for of_model in whole]
        predictions.append(_prediction(output.name, output.unit, None, errors, rng))
    if 1 < len(dataset.trials) < FEW_TRIALS:
        notes.append(f"intervals rest on {len(dataset.trials)} trials only and are coarse")
    if len(dataset.trials) == 1:
        notes.append(
            f"there is one trial: intervals come from {_FRESH_PIECES} pieces of it and know nothing of "
            "how trials differ"
        )
    return FreshTest(
        model.name,
        "" if before is None else before.name,
        dataset.name,
        len(dataset.trials),
        FEWEST_SAMPLES if horizons else 0,
        tuple(predictions),
        tuple(dict.fromkeys(notes)),
    )


def _horizons(dataset: Dataset, asked: Sequence[float] | None, notes: list[str]) -> tuple[float, ...]:
    """Return the horizons that at least one trial is long enough for."""
    longest = max(
        (
            float(trial.time_s[-1] - trial.time_s[FEWEST_SAMPLES - 1])
            for trial in dataset.trials
            if len(trial.time_s) > FEWEST_SAMPLES
        ),
        default=0.0,
    )
    for horizon in asked or ():
        if not 0.0 < horizon <= longest:
            raise RequestError(
                f"a horizon of {horizon:g} s cannot be tested on {dataset.name}",
                hint=f"behind the {FEWEST_SAMPLES} samples that tell the states, its longest trial leaves "
                f"{longest:.3g} s: ask for more than 0 and at most that",
            )
    fitting = tuple(sorted({*(asked or _FRESH_HORIZONS_S)}))
    short = [horizon for horizon in fitting if horizon > longest]
    if short:
        notes.append(
            f"trials are too short for a horizon of {' or '.join(f'{horizon:g}' for horizon in short)} s"
        )
    return tuple(horizon for horizon in fitting if horizon <= longest)


def _ahead(
    model: Model, dataset: Dataset, horizons: Sequence[float], notes: list[str], note: Note
) -> list[FloatArray]:
    """Return measured minus predicted at every horizon, per trial (starts, horizons, outputs).

    NaN where the trial ends before, or the prediction leaves the finite numbers.
    """
    note(f"predicting ahead with {model.name}")
    free = replace(model, initial=dict.fromkeys(model.states, "free"))
    pieces, owner = [], []
    for index, trial in enumerate(dataset.trials):
        for start in _starts(trial, horizons[0]):
            end = (
                int(np.searchsorted(trial.time_s, trial.time_s[start + FEWEST_SAMPLES - 1] + horizons[-1]))
                + 1
            )
            pieces.append(_cut(trial, start, min(end + 1, len(trial.time_s))))
            owner.append(index)
    cut = replace(dataset, trials=tuple(pieces))
    problem = Problem.of(free, cut)
    warm = problem.beginning(0.0)
    shared = warm.priors.stated
    z = minimise(
        warm, np.concatenate([shared, problem.guess(problem.priors.values)]), lower=shared, upper=shared
    )
    parameters, broken = problem.parameters(z), 0
    errors: list[list[FloatArray]] = [[] for _ in dataset.trials]
    for index, piece in enumerate(pieces):
        outputs = problem.simulate(parameters, index, problem.own(z, index))
        broken += outputs is None
        errors[owner[index]].append(_at(piece, outputs, horizons))
    if broken:
        notes.append(
            f"{broken} of {len(pieces)} predictions of {model.name} leave the finite numbers and are not counted"
        )
    width = (len(horizons), len(dataset.outputs))
    return [np.array(error).reshape(-1, *width) for error in errors]


def _starts(trial: FitTrial, shortest_s: float) -> list[int]:
    """Return the samples at which predictions begin to learn their states."""
    last = int(np.searchsorted(trial.time_s, trial.time_s[-1] - shortest_s, side="right")) - FEWEST_SAMPLES
    return [] if last < 0 else np.unique(np.linspace(0, last, _FRESH_STARTS).astype(int)).tolist()


def _cut(trial: FitTrial, begin: int, end: int) -> FitTrial:
    part = slice(begin, end)
    return replace(
        trial, time_s=trial.time_s[part], inputs=trial.inputs[part], outputs=trial.outputs[part], members=()
    )


def _at(piece: FitTrial, outputs: FloatArray | None, horizons: Sequence[float]) -> FloatArray:
    """Return measured minus predicted at each horizon behind the samples that told the states."""
    predicted = np.full((len(horizons), piece.outputs.shape[1]), np.nan)
    now = piece.time_s[FEWEST_SAMPLES - 1]
    half = 0.5 * float(np.median(np.diff(piece.time_s)))
    for index, horizon_s in enumerate(horizons):
        sample = int(np.searchsorted(piece.time_s, now + horizon_s - half))
        if outputs is not None and sample < len(piece.time_s):
            predicted[index] = piece.outputs[sample] - outputs[sample]
    return predicted


def _whole(model: Model, dataset: Dataset) -> list[FloatArray]:
    """Return measured minus simulated of every trial (n, outputs), the beginning fitted where it is not stated."""
    begin = {state: "free" if rule == "first" else rule for state, rule in model.initial.items()}
    problem = Problem.of(replace(model, initial=begin), dataset)
    z = stated(problem, problem.begin())
    return [
        trial.outputs - outputs for trial, outputs in zip(dataset.trials, problem.simulated(z), strict=True)
    ]


def _prediction(
    output: str,
    unit: str,
    horizon_s: float | None,
    errors: Sequence[Sequence[FloatArray]],
    rng: np.random.Generator,
) -> Prediction:
    """Return root mean squares and their ratio from the errors of one or two models, trial by trial."""
    known = [
        np.all([np.isfinite(model_errors) for model_errors in trial], axis=0)
        for trial in zip(*errors, strict=True)
    ]
    squares = [
        [np.square(trial[where]) for trial, where in zip(trials, known, strict=True)] for trials in errors
    ]
    if len(known) == 1:
        squares = [np.array_split(square[0], _FRESH_PIECES) for square in squares]
    kept = [index for index, model_errors in enumerate(squares[0]) if len(model_errors)]
    if not kept:
        raise FitError(
            "no prediction stays within the finite numbers", hint="check the model's units and signs"
        )
    counts = np.array([float(len(squares[0][index])) for index in kept])
    sums = np.array([[float(np.sum(square[index])) for index in kept] for square in squares])
    means = np.maximum(sums.sum(axis=1) / counts.sum(), 1e-300)
    relative = sums / means[:, None] - counts
    values = np.sqrt(means)
    estimates = [_estimate(value, relative[model], counts, unit, rng) for model, value in enumerate(values)]
    ratio = None
    if len(estimates) > 1:
        ratio = _estimate(float(values[0] / values[1]), relative[0] - relative[1], counts, "1", rng)
    before = estimates[1] if len(estimates) > 1 else None
    return Prediction(output, horizon_s, estimates[0], before, ratio, int(counts.sum()))


def _estimate(
    value: float, relative: FloatArray, counts: FloatArray, unit: str, rng: np.random.Generator
) -> ResampledNumber:
    """Return a root mean square with its interval: whole trials resampled, in the logarithm, where it is nearest even.

    Parameters
    ----------
    relative : (T,)
        By how much each trial's sum of squares exceeds its part, in units of the mean square.
    counts : (T,)
    """
    if len(counts) == 1:
        return ResampledNumber(float(value), 0.0, np.inf, unit)
    trials = resample_trials(counts[:, None, None], relative[:, None], rng=rng)
    low, high = 0.5 * np.clip([trials.low[0], trials.high[0]], -600.0, 600.0)
    return ResampledNumber(float(value), float(value * np.exp(low)), float(value * np.exp(high)), unit)
