"""What differs from trial to trial: a zero that was set anew, a clock started by hand, a gain that is never the same.

A mixed-effects model (Laird and Ware, Biometrics 38 (1982) 963): each trial has a small deviation of its own, drawn
from one distribution whose variance is estimated. It is neither noise of single samples nor a cause common to all.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import SIMULATED, Dataset, Deviation, DeviationKind, Problem
from labrun.gap import criteria, decide
from labrun.gap.candidates import typical_time_s
from labrun.gap.evidence import correlation_samples

_BEGINNING = 0.05
"""Part of a typical period that counts as a trial's beginning."""
_BEGINNING_SAMPLES = 3
"""Samples that a trial's beginning has at least."""
_NO_DEVIATION = 0.3
"""Root mean square, in units of its spread, below which a deviation has lost its place to a cause."""
_MOST_DEVIATIONS = 3
"""Deviations by trial that are taken apart at most."""
_SIMPLER_SHARE = 0.02
"""Share of the residual by which an input's deviation has to be larger than an output's to go first."""
_FEWEST_AGREEING = 3
"""Trials from which chance can be told from what they have in common."""

_KINDS: tuple[DeviationKind, ...] = ("bias", "start time", "gain")
ALSO_SHAPES: tuple[DeviationKind, ...] = ("gain", "start time", "input gain")
"""What changes with amplitude or frequency looks like these, too, but leaves something once everything is fitted."""
_NUDGE = 1e-3
"""Part of the outputs' spread that an initial state is moved by, and of an input's peak."""


@dataclass(frozen=True)
class TrialDeviations:
    """Deviations by trial, and residuals without them.

    Attributes
    ----------
    residual : per unit, per member (n, m)
    """

    deviations: tuple[Deviation, ...]
    residual: list[list[FloatArray]]


def deviations_of_repeats(
    units: Dataset, residual: Sequence[Sequence[FloatArray]], simulated: Sequence[FloatArray]
) -> TrialDeviations:
    """Look for what repeats of a condition differ in as whole trials, the largest first.

    One counts if, estimated from other blocks of time of a trial, it predicts by the rule how far a block of it lies
    from the mean of its condition.

    Parameters
    ----------
    residual : per unit, per member (n, m)
        Measured minus simulated of every trial.
    """
    deviations: list[Deviation] = []
    remainder = [list(members) for members in residual]
    outputs = range(units.trials[0].outputs.shape[1])
    tried = [(kind, output) for kind in _KINDS for output in (outputs if kind != "start time" else (None,))]
    while len(deviations) < _MOST_DEVIATIONS:
        known = [(deviation.kind, deviation.output) for deviation in deviations]
        rest = [(kind, output) for kind, output in tried if (kind, output) not in known]
        results = [_rated_in_repeats(units, remainder, simulated, kind, output) for kind, output in rest]
        best = max(
            (result for result in results if result is not None), key=lambda result: result[0], default=None
        )
        if best is None:
            break
        _, deviation, remainder = best
        deviations.append(deviation)
    return TrialDeviations(tuple(deviations), remainder)


_RatedInRepeats = tuple[float, Deviation, list[list[FloatArray]]]


def _rated_in_repeats(
    units: Dataset,
    residual: list[list[FloatArray]],
    simulated: Sequence[FloatArray],
    kind: DeviationKind,
    output: int | None,
) -> _RatedInRepeats | None:
    """Return the share of the disagreement that one kind makes up, its deviation, and residuals without it."""
    after = [list(members) for members in residual]
    away, shapes = list[FloatArray](), list[FloatArray]()
    freedom, scale = 0, _disagreement(units, residual)
    columns = slice(None) if output is None else slice(output, output + 1)
    sizes = list[float]()
    for group in range(len(units.conditions)):
        members = [
            (index, member) for index in units.of_group(group) for member in range(len(residual[index]))
        ]
        if len(members) < 2:
            continue
        length = min(len(residual[index][member]) for index, member in members)
        mean = np.mean([residual[index][member][:length] for index, member in members], axis=0)
        for index, member in members:
            signature = (shape_of(kind, simulated[index], units.trials[index].time_s) / scale)[:, columns]
            shapes.append(signature[:length])
            away.append(((residual[index][member][:length] - mean) / scale)[:, columns])
            energy = float(np.sum(np.square(shapes[-1])))
            sizes.append(float(np.sum(shapes[-1] * away[-1])) / energy if energy > 0 else 0.0)
            after[index][member] = residual[index][member].copy()
            after[index][member][:, columns] -= sizes[-1] * signature * scale[columns]
        freedom += len(members) - 1
    total = sum(float(np.sum(np.square(rows))) for rows in away)
    taken = sum(size**2 * float(np.sum(np.square(shape))) for size, shape in zip(sizes, shapes, strict=True))
    if total == 0.0 or taken < criteria.SHARE_OF_GAP * total:
        return None
    if not _predicts_unseen_blocks(away, shapes, np.array(sizes), 0.0):
        return None
    sd = float(np.sqrt(np.sum(np.square(sizes)) / freedom))
    return taken / total, Deviation(kind, output, sd), after


def simulated_changes(problem: Problem, z: FloatArray) -> dict[tuple[DeviationKind, int], list[FloatArray]]:
    """Return by what the outputs (n, m) of every trial change with what a simulation begins with or is driven by.

    Of a bias and a gain of each input that varies, and of each stated initial state that all trials share.
    """
    before, parameters = problem.simulated(z), problem.parameters(z)
    inputs = np.concatenate([trial.inputs for trial in problem.data.trials])
    varying = [column for column in range(inputs.shape[1]) if np.ptp(inputs[:, column]) > 0]
    steps: dict[tuple[DeviationKind, int], float] = {
        ("initial state", state): _NUDGE * float(np.max(problem.spread))
        for state in range(len(problem.model.states))
        if state not in problem.states.free
    }
    for column in varying:
        steps["input bias", column] = _NUDGE * float(np.max(np.abs(inputs[:, column])))
        steps["input gain", column] = _NUDGE
    by_change = {}
    for (kind, output), step in steps.items():
        if (kind, output) in [(deviation.kind, deviation.output) for deviation in problem.deviations]:
            continue
        nudged = replace(problem, deviations=(*problem.deviations, Deviation(kind, output, step)))
        changes = []
        for index, (trial, outputs) in enumerate(zip(problem.data.trials, before, strict=True)):
            own = np.append(problem.own(z, index), np.sqrt(trial.count))
            after = nudged.simulate(parameters, index, own)
            changes.append(np.zeros_like(outputs) if after is None else (after - outputs) / step)
        by_change[kind, output] = changes
    return by_change


def beginning_s(problem: Problem) -> float:
    """Return how long a trial's beginning lasts."""
    return _BEGINNING * typical_time_s(problem)


def _samples_within(short_s: float, time_s: FloatArray) -> int:
    return max(int(np.searchsorted(time_s, time_s[0] + short_s)), _BEGINNING_SAMPLES)


def deviating_initial_states(problem: Problem, z: FloatArray, noise_sd: FloatArray) -> tuple[Deviation, ...]:
    """Look for stated initial states that the first samples of trials which were never repeated contradict.

    A plate that is released by hand does not begin where it should. What all trials plainly share is a zero error.

    Parameters
    ----------
    noise_sd : (m,)
        Of a sample.
    """
    deviations, short_s = [], beginning_s(problem)
    simulated = problem.simulated(z)
    for state in set(range(len(problem.model.states))) - set(problem.states.free):
        output = problem.states.output_of(state)
        if output is None:
            continue
        away, variance = [], 0.0
        for trial, outputs in zip(problem.data.trials, simulated, strict=True):
            count = _samples_within(short_s, trial.time_s)
            begins = (trial.outputs - outputs)[:count, output]
            away.append(float(np.mean(begins)))
            variance += float(noise_sd[output]) ** 2 / len(begins)
        sd = float(np.sqrt(np.mean(np.square(np.array(away) - _common_part(np.array(away))))))
        if sd > criteria.SAME_BEGINNING * np.sqrt(variance / len(away)):
            deviations.append(Deviation("initial state", state, sd))
    return tuple(deviations)


def outputs_without_common_zero(residual: Sequence[FloatArray], deviations: Sequence[Deviation]) -> list[int]:
    """Return the outputs whose zeros differ by trial without a part that all trials plainly share, by column."""
    biases = [
        deviation.output
        for deviation in deviations
        if deviation.kind == "bias" and deviation.output is not None
    ]
    return [
        output
        for output in biases
        if _common_part(np.array([float(np.mean(trial_residual[:, output])) for trial_residual in residual]))
        == 0.0
    ]


def _common_part(own: FloatArray) -> float:
    """Return what deviations have in common; 0 where chance would make them agree as well.

    Two trials cannot tell chance: what they agree on counts as common.
    """
    from scipy.stats import ttest_1samp

    if len(own) < _FEWEST_AGREEING or np.ptp(own) == 0.0:
        return float(np.mean(own))
    return float(np.mean(own)) if ttest_1samp(own, 0.0).pvalue <= criteria.DEVIATION_P else 0.0


def deviations_without_repeats(
    units: Dataset,
    residual: Sequence[FloatArray],
    simulated: Sequence[FloatArray],
    changes: Mapping[tuple[DeviationKind, int], Sequence[FloatArray]] | None = None,
    short_s: float = 0.0,
) -> list[tuple[Deviation, ...]]:
    """Look for what trials that were never repeated differ by as a whole, where no cause explains what is left of them.

    A deviation is as large in one block of its trial as in another. One counts if, estimated from other blocks, it
    predicts a block by the rule better than what all trials plainly share of it, which is a gap like any other.

    Parameters
    ----------
    residual, simulated : per unit (n, m)
        Of the model with its causes.
    changes
        `simulated_changes` of it.
    short_s
        How long the beginning of a trial lasts, which has to show what the trial is said to begin with.

    Returns
    -------
    list
        What it may be. First a set, each of it the largest in what those before it leave, an output's own before an
        input's that is as large; then every kind alone. Of `ALSO_SHAPES`, which only a fit decides on, also those that
        blocks of a trial do not agree on: where friction holds a joint still, a gain shows nothing.
    """
    outputs = range(units.trials[0].outputs.shape[1])
    kinds = [(kind, output) for kind in _KINDS for output in (outputs if kind != "start time" else (None,))]
    shapes: dict[tuple[DeviationKind, int | None], list[FloatArray]] = {
        (kind, output): [
            shape_of(kind, outputs, trial.time_s)
            for outputs, trial in zip(simulated, units.trials, strict=True)
        ]
        for kind, output in kinds
    }
    for key, change in (changes or {}).items():
        shapes[key] = list(change)
    begin = [_samples_within(short_s, trial.time_s) for trial in units.trials]
    accepted, alone, remainder = list[Deviation](), list[Deviation](), list(residual)
    while len(accepted) < _MOST_DEVIATIONS:
        known = [(deviation.kind, deviation.output) for deviation in accepted]
        rated = [
            entry
            for key, shape in shapes.items()
            if key not in known
            and (entry := _rated_without_repeats(remainder, shape, *key, begin)) is not None
        ]
        if not accepted:
            alone = [
                entry.deviation
                for entry in rated
                if entry.predicts_unseen or entry.deviation.kind in ALSO_SHAPES
            ]
        predictive = [entry for entry in rated if entry.predicts_unseen]
        if not predictive:
            break
        most = max(entry.share for entry in predictive)
        best = next(entry for entry in predictive if entry.share >= most - _SIMPLER_SHARE)
        remainder = best.residual
        accepted.append(best.deviation)
    sets = [tuple(accepted)] if accepted else []
    return list(dict.fromkeys([*sets, *((deviation,) for deviation in alone)]))


@dataclass(frozen=True)
class _Rated:
    """A deviation of trials that were not repeated.

    Attributes
    ----------
    share
        Share of the squared residual that it makes up.
    residual
        What it leaves.
    predicts_unseen
        Whether it predicts blocks of time that it was not estimated from.
    """

    share: float
    deviation: Deviation
    residual: list[FloatArray]
    predicts_unseen: bool


def _rated_without_repeats(
    residual: list[FloatArray],
    signature: Sequence[FloatArray],
    kind: DeviationKind,
    output: int | None,
    beginnings: Sequence[int],
) -> _Rated | None:
    """Return what one kind makes up of the residual; None if that is little, or not to be told."""
    if len(residual) < 2:
        return None
    every = output is None or kind in SIMULATED
    columns = slice(None) if every else slice(output, (output or 0) + 1)
    scale = np.sqrt(np.mean(np.square(np.concatenate(residual)), axis=0))
    scale = np.where(scale > 0, scale, 1.0)
    shapes = [(shape / scale)[:, columns] for shape in signature]
    away = [(trial_residual / scale)[:, columns] for trial_residual in residual]
    energy = np.array([np.sum(np.square(shape)) for shape in shapes])
    total = float(sum(np.sum(np.square(trial_residual)) for trial_residual in away))
    if np.any(energy <= 0) or total == 0.0:
        return None
    own = np.array([np.sum(a * b) for a, b in zip(shapes, away, strict=True)]) / energy
    shared = _common_part(own)
    taken = float(np.sum(np.square(own - shared) * energy))
    if taken < criteria.SHARE_OF_GAP * total:
        return None
    if kind == "initial state" and not _improves_first_samples(shapes, away, own - shared, beginnings):
        return None
    after = []
    for trial_residual, shape, size in zip(residual, shapes, own - shared, strict=True):
        cleared = trial_residual.copy()
        cleared[:, columns] -= size * shape * scale[columns]
        after.append(cleared)
    sd = float(np.sqrt(np.sum(np.square(own - shared)) / (len(own) - int(shared != 0.0))))
    predicts_unseen = _predicts_unseen_blocks(away, shapes, own, shared)
    return _Rated(taken / total, Deviation(kind, output, sd), after, predicts_unseen)


def _predicts_unseen_blocks(
    residual: Sequence[FloatArray], shapes: Sequence[FloatArray], own: FloatArray, shared: float
) -> bool:
    """Tell by the rule whether a size of each trial's own predicts a block of the trial that it was not fitted to.

    Parameters
    ----------
    residual, shapes : per trial (n, k)
    own, shared
        Sizes of the whole trials, and what they have in common, which is compared with.
    """
    wanted = max(int(np.ceil(criteria.ENOUGH_UNITS / len(residual))), 2)
    before, after, strata = list[float](), list[float](), list[int]()
    for trial, (rows, shape, size) in enumerate(zip(residual, shapes, own, strict=True)):
        blocks = min(wanted, int(len(rows) / correlation_samples(rows - size * shape)))
        if blocks < 2:
            continue
        pairs = list(zip(np.array_split(rows, blocks), np.array_split(shape, blocks), strict=True))
        energy = np.array([np.sum(np.square(part)) for _, part in pairs])
        along = np.array([np.sum(block * part) for block, part in pairs])
        for index, (block, part) in enumerate(pairs):
            others = float(np.sum(energy) - energy[index])
            elsewhere = float(np.sum(along) - along[index]) / others if others > 0 else shared
            usual = np.mean(np.square(block - shared * part))
            error = np.mean(np.square(block - elsewhere * part)) + criteria.NEGLIGIBLE**2 * usual
            before.append(float(np.log(max(usual, np.finfo(float).tiny))))
            after.append(float(np.log(max(error, np.finfo(float).tiny))))
            strata.append(trial)
    return len(before) > 1 and decide.beats(np.array(after), np.array(before), np.array(strata))


def _improves_first_samples(
    shapes: Sequence[FloatArray], residual: Sequence[FloatArray], own: FloatArray, beginnings: Sequence[int]
) -> bool:
    """Tell whether less is left at the beginning of trials without what they are said to begin with.

    A drag that acts at some angles only looks, over whole trials, like releases from elsewhere; first samples know
    better. A state that no output shows at once leaves nothing to ask.
    """
    before = after = 0.0
    for shape, trial_residual, size, count in zip(shapes, residual, own, beginnings, strict=True):
        column = int(np.argmax(np.abs(shape[0])))
        if shape[0, column] != 0.0:
            before += float(np.sum(np.square(trial_residual[:count, column])))
            after += float(np.sum(np.square((trial_residual - size * shape)[:count, column])))
    return after < before or before == 0.0


def remaining(problem: Problem, z: FloatArray) -> tuple[tuple[Deviation, float], ...]:
    """Return the deviations of a fit, less those whose place something else has taken, each with its mean.

    The mean over all trials is 0 where chance would make them agree as well.
    """
    count = len(problem.deviations)
    if count == 0:
        return ()
    own = problem.own_states(z).reshape(len(problem.data.trials), problem.own_size)[:, -count:]
    sizes = np.sqrt(np.mean(np.square(own), axis=0))
    repeats = np.sqrt([trial.count for trial in problem.data.trials])
    kept = []
    for index, deviation in enumerate(problem.deviations):
        if sizes[index] >= _NO_DEVIATION:
            values = own[:, index] * deviation.sd / repeats
            kept.append((deviation, _common_part(values) if len(values) >= _FEWEST_AGREEING else 0.0))
    return tuple(kept)


def words(
    deviation: Deviation,
    outputs: Sequence[tuple[str, str]],
    states: Sequence[str] = (),
    inputs: Sequence[tuple[str, str]] = (),
    mean: float = 0.0,
) -> str:
    """Return a deviation in words.

    Parameters
    ----------
    outputs, inputs
        Names and units.
    states
        Names.
    mean
        Over all trials, in the unit of the deviation; 0 where they have none in common.
    """
    names, unit = dict(outputs), ""
    if deviation.kind == "initial state" and deviation.output is not None:
        state = states[deviation.output]
        subject, unit = f"the {state} that a trial begins with", names.get(state, "")
    elif deviation.kind == "start time" or deviation.output is None:
        subject, unit = "the start time", "s"
    else:
        kind = deviation.kind.removeprefix("input ")
        name, unit = (outputs if kind == deviation.kind else inputs)[deviation.output]
        subject, unit = f"{kind} at {name}", "%" if kind == "gain" else unit

    def size(value: float) -> str:
        return f"{100.0 * value if unit == '%' else value:.2g} {unit}".removesuffix(" 1").rstrip()

    spread = f"standard deviation {size(deviation.sd)}"
    return f"{subject} differs by trial ({f'mean {size(mean)}, ' if mean else ''}{spread})"


def shape_of(kind: DeviationKind, simulated: FloatArray, time_s: FloatArray) -> FloatArray:
    """Return by what outputs (n, m) change with a deviation of one: unit of the output, second, or factor."""
    if kind == "bias":
        return np.ones_like(simulated)
    if kind == "gain":
        return simulated
    return (
        -np.asarray(np.gradient(simulated, time_s, axis=0)) if len(time_s) > 1 else np.zeros_like(simulated)
    )


def _disagreement(units: Dataset, residual: Sequence[Sequence[FloatArray]]) -> FloatArray:
    """Return the root mean square of what repeats do not agree on, per output; 1 where they agree, (m,)."""
    squares = []
    for group in range(len(units.conditions)):
        trials = [trial_residual for index in units.of_group(group) for trial_residual in residual[index]]
        length = min(map(len, trials), default=0)
        if len(trials) > 1:
            mean = np.mean([trial[:length] for trial in trials], axis=0)
            squares += [np.mean(np.square(trial[:length] - mean), axis=0) for trial in trials]
    size = np.sqrt(np.mean(squares, axis=0)) if squares else np.ones(residual[0][0].shape[1])
    return np.asarray(np.where(size > 0, size, 1.0))
