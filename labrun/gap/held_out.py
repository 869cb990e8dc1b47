"""What a fit leaves beyond the noise, on conditions it never saw."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, Jacobian, Problem, minimise
from labrun.gap import criteria
from labrun.gap.noise import Noise
from labrun.gap.nuisance import information, unseen

_FOLD_TOLERANCE = 0.001
"""Relative fall of the sum of squares at which a fit without a condition ends."""
_FOLD_EVALUATIONS = 16
"""Most evaluations of such a fit."""
_FOLD_RENEWALS = 2
"""Most times that derivatives are computed anew in such a fit."""
_FINER_STEPS = 8
"""What is stiff in a withheld condition only is simulated again with so many times the integrator's steps."""
_FLOOR_DRAWS = 200
"""Draws of noise behind the floor."""
_FLOOR_PERCENTILE = 95.0
"""Percentile of the gaps that noise alone leaves, which is the floor."""


@dataclass(frozen=True)
class ExcessResidual:
    """Excess of the squared mean residual over the noise floor, condition by condition.

    Attributes
    ----------
    values : (groups, m)
        Mean over a condition's samples, in units of the variance of one trial's noise. May be slightly negative.
    weights : (groups,)
        Share of the samples.
    residual : per trial (n, m)
        What it was made from, in the units of the outputs.
    """

    values: FloatArray
    weights: FloatArray
    residual: Sequence[FloatArray] = field(repr=False)

    @property
    def total(self) -> float:
        """Mean over channels and samples."""
        return float(self.weights @ np.mean(self.values, axis=1))

    @property
    def gap(self) -> float:
        """Root mean square of the systematic residual over channels, in units of one trial's noise."""
        return float(np.sqrt(max(self.total, 0.0)))


def mean_residuals(problem: Problem, z: FloatArray) -> list[FloatArray]:
    """Return measured mean minus simulated of every unit, (n, m) each, in the units of the outputs."""
    return [
        trial.outputs - outputs
        for trial, outputs in zip(problem.data.trials, problem.simulated(z), strict=True)
    ]


def group_means(units: Dataset, residual: Sequence[FloatArray]) -> list[tuple[FloatArray, int]]:
    """Return the mean residual of every condition and the number of trials behind it."""
    means = []
    for group in range(len(units.conditions)):
        members = units.of_group(group)
        if not members:
            continue
        counts = np.array([units.trials[index].count for index in members], dtype=float)
        length = min(len(residual[index]) for index in members)
        stacked = np.stack([residual[index][:length] for index in members])
        means.append((np.tensordot(counts / counts.sum(), stacked, axes=1), int(counts.sum())))
    return means


def excess(
    data: Dataset, noise: Noise, residual: Sequence[FloatArray], deviations: Sequence[float] = ()
) -> ExcessResidual:
    """Return the excess of mean residuals (one array per trial) over the noise floor.

    Parameters
    ----------
    deviations : per trial
        What its own deviations have beyond their spread, in the same units: those that all trials share are a gap.
    """
    groups = group_means(data, residual)
    present = [group for group in range(len(data.conditions)) if data.of_group(group)]
    values = [
        np.mean(np.square(mean / noise.sd), axis=0) - noise.mean_floor(group, count)
        for group, (mean, count) in zip(present, groups, strict=True)
    ]
    if deviations:
        beyond = [np.mean([deviations[index] for index in data.of_group(group)]) for group in present]
        values = [value + more for value, more in zip(values, beyond, strict=True)]
    sizes = np.array([float(len(mean)) for mean, _ in groups])
    return ExcessResidual(np.array(values), sizes / sizes.sum(), residual)


def _beyond_spread(problem: Problem, trial: int, own: FloatArray) -> float:
    """Return what deviations of a trial's own have beyond their spread, per sample, in units of one trial's noise."""
    if not problem.deviations:
        return 0.0
    data = problem.data.trials[trial]
    squares = float(np.sum(np.square(own[len(own) - len(problem.deviations) :]))) - len(problem.deviations)
    return squares / data.count / data.outputs.size


def fitted_excess(problem: Problem, z: FloatArray, noise: Noise) -> ExcessResidual:
    """Return what a fit leaves of the data it has seen."""
    trials = range(len(problem.data.trials))
    beyond = [_beyond_spread(problem, index, problem.own(z, index)) for index in trials]
    return excess(problem.data, noise, mean_residuals(problem, z), beyond)


def floor_of(data: Dataset, noise: Noise, rng: np.random.Generator) -> float:
    """Return the systematic residual that noise alone shows at most in 95 of 100 experiments."""
    drawn = [excess(data, noise, noise.draw(data, rng)).gap for _ in range(_FLOOR_DRAWS)]
    return float(np.percentile(drawn, _FLOOR_PERCENTILE))


def unseen_residuals(problem: Problem, z: FloatArray) -> list[tuple[FloatArray, float]]:
    """Return measured minus simulated of every trial by fits from `z` that have not seen it.

    With each, what the trial's own deviations have beyond their spread. Conditions are withheld one at a time; of a
    single condition, blocks of time.
    """
    single = len(problem.data.conditions) == 1
    return _block_residuals(problem, z) if single else held_out_residuals(problem, z)


def held_out_excess(problem: Problem, z: FloatArray, noise: Noise) -> ExcessResidual:
    """Return what fits from `z` leave of conditions they have not seen; of one condition, of blocks of time."""
    residual, beyond = zip(*unseen_residuals(problem, z), strict=True)
    return excess(problem.data, noise, list(residual), list(beyond))


def folds(groups: int) -> list[list[int]]:
    """Return which conditions are left out together: one at a time, at most eight folds."""
    count = min(groups, criteria.FOLDS)
    return [list(range(fold, groups, count)) for fold in range(count)]


def held_out_residuals(problem: Problem, z: FloatArray) -> list[tuple[FloatArray, float]]:
    """Return measured minus simulated of every unit, from fits that did not see its condition.

    With each what its own deviations have beyond their spread.

    Only the unit's own initial states are fitted to it. The size of an effect that shows in the withheld condition
    alone (a level that only the largest motion reaches) cannot be learned from the others: it stays what the fit of
    everything made it, and all else is fitted without that condition.
    """
    groups = len(problem.data.conditions)
    residual: list[tuple[FloatArray, float] | None] = [None] * len(problem.data.trials)
    everything = range(len(problem.data.trials))
    # leaving a condition out moves the fit a little: derivatives taken once show every fold its way
    jacobian = problem.jacobian(z, central=False)
    known = information(problem, z, jacobian)
    for left_out in folds(groups):
        test = [index for index in everything if problem.data.trials[index].group in left_out]
        train = [index for index in everything if index not in test]
        shared = _trained(problem, z, train, jacobian, known)
        for index, tested in zip(test, _tested(problem, z, shared, test, jacobian), strict=True):
            residual[index] = tested
    return [tested for tested in residual if tested is not None]


def _block_residuals(problem: Problem, z: FloatArray) -> list[tuple[FloatArray, float]]:
    """Return measured minus simulated of every unit, each block of time from a fit that did not see it.

    Every trial runs as a whole, its initial states told by the other blocks.
    """
    trials = range(len(problem.data.trials))
    predicted = zip(problem.data.trials, _predicted(problem, z), strict=True)
    residual = [trial.outputs - outputs for trial, outputs in predicted]
    beyond = [_beyond_spread(problem, index, problem.own(z, index)) for index in trials]
    blocks = min(criteria.FOLDS, min(map(len, residual)) // 2)
    if blocks < 2:
        return list(zip(residual, beyond, strict=True))
    jacobian = problem.jacobian(z, central=False)
    known = information(problem, z, jacobian)
    block_of = [np.arange(len(rows)) * blocks // len(rows) for rows in residual]
    for block in range(blocks):
        part = problem.with_seen([np.where(rows == block, 0.0, 1.0) for rows in block_of])
        end = _learned(part, z, _seen_rows(jacobian, part), known)
        for index, outputs in enumerate(_predicted(part, end)):
            withheld = block_of[index] == block
            residual[index][withheld] = (problem.data.trials[index].outputs - outputs)[withheld]
    return list(zip(residual, beyond, strict=True))


def _seen_rows(jacobian: Jacobian, problem: Problem) -> Jacobian:
    """Return derivatives of which what is withheld counts nothing."""
    kept = []
    for trial, seen, residual in zip(problem.data.trials, problem.seen or (), jacobian.residual, strict=True):
        rows = np.repeat(seen, trial.outputs.shape[1])
        kept.append(np.concatenate([rows, np.ones(len(residual) - len(rows))]))
    return Jacobian(
        [trial_rows * rows[:, None] for trial_rows, rows in zip(jacobian.shared, kept, strict=True)],
        [trial_rows * rows[:, None] for trial_rows, rows in zip(jacobian.own, kept, strict=True)],
        [trial_rows * rows for trial_rows, rows in zip(jacobian.residual, kept, strict=True)],
    )


def not_withheld(problem: Problem, z: FloatArray, jacobian: Jacobian) -> tuple[str, ...]:
    """Return a sentence for every size of an effect that stayed as it was where a condition was withheld.

    Parameters
    ----------
    jacobian
        Derivatives at `z`.
    """
    groups = len(problem.data.conditions)
    if groups == 1 or not problem.effects:
        return ()
    known = information(problem, z, jacobian)
    everything = range(len(problem.data.trials))
    names = set()
    for left_out in folds(groups):
        train = [index for index in everything if problem.data.trials[index].group not in left_out]
        part = problem.part(train)
        start = np.concatenate([z[: problem.size], _own(problem, z, train)])
        stays = unseen(problem, known, information(part, start, jacobian.part(train)))
        names |= {problem.priors.names[variable] for variable in np.flatnonzero(stays)}
    sentences = []
    for name in sorted(names):
        number, _, parameter = name.partition(".")
        effect = problem.effects[int(number)]
        sentences.append(
            f"{parameter} of {effect.effect.id} at {effect.site} shows in one condition only: where that was "
            "withheld, it "
            "was not learned from the others"
        )
    return tuple(sentences)


def _own(problem: Problem, z: FloatArray, chosen: Sequence[int]) -> FloatArray:
    own = problem.own_states(z).reshape(len(problem.data.trials), problem.own_size)
    return own[list(chosen)].ravel()


def _trained(
    problem: Problem, z: FloatArray, train: Sequence[int], jacobian: Jacobian, known: FloatArray
) -> FloatArray:
    part = problem.part(train)
    start = np.concatenate([z[: problem.size], _own(problem, z, train)])
    return _learned(part, start, jacobian.part(train), known)[: problem.size]


def _learned(part: Problem, start: FloatArray, seen: Jacobian, known: FloatArray) -> FloatArray:
    """Return the fit to a part of the data; sizes that it knows next to nothing of stay as they were.

    Parameters
    ----------
    seen
        Derivatives and residuals of that part at `start`.
    """
    stays = unseen(part, known, information(part, start, seen))
    shared = start[: part.size]
    return minimise(
        part,
        start,
        lower=np.where(stays, shared, part.priors.lower),
        upper=np.where(stays, shared, part.priors.upper),
        tolerance=_FOLD_TOLERANCE,
        evaluations=_FOLD_EVALUATIONS,
        central=False,
        derivatives=seen,
        secant=True,
        confirmed=False,
        renewals=_FOLD_RENEWALS,
        residual=seen.residual,
    )


def _tested(
    problem: Problem, z: FloatArray, shared: FloatArray, test: Sequence[int], jacobian: Jacobian
) -> list[tuple[FloatArray, float]]:
    part = problem.part(test)
    start = np.concatenate([shared, _own(problem, z, test)])
    if problem.own_size:
        start = minimise(
            part,
            start,
            lower=shared,
            upper=shared,
            tolerance=_FOLD_TOLERANCE,
            evaluations=_FOLD_EVALUATIONS,
            central=False,
            derivatives=jacobian.part(test),
            secant=True,
            confirmed=False,
        )
    return [
        (trial.outputs - outputs, _beyond_spread(part, index, part.own(start, index)))
        for index, (trial, outputs) in enumerate(zip(part.data.trials, _predicted(part, start), strict=True))
    ]


def _predicted(part: Problem, z: FloatArray) -> list[FloatArray]:
    """Return the outputs of every unit, where they are not finite the channels' means.

    Parameters that blow up elsewhere explain nothing there.
    """
    results = []
    parameters = part.parameters(z)
    for index, trial in enumerate(part.data.trials):
        outputs = part.simulate(parameters, index, part.own(z, index))
        if outputs is None:  # what is stiff in this condition only may want shorter steps
            outputs = part.with_substeps(_FINER_STEPS * part.substeps).simulate(
                parameters, index, part.own(z, index)
            )
        means = np.broadcast_to(np.mean(trial.outputs, axis=0), trial.outputs.shape)
        results.append(means if outputs is None else outputs)
    return results
