"""How far trials would tell explanations apart, once each has been fitted to what the others predict (T-optimality).

Atkinson and Fedorov, Biometrika 62 (1975).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset
from labrun.gap import criteria, decide
from labrun.gap.next.imitation import Change, Imitation, Recorded
from labrun.gap.next.rivals import Rival, Rivals
from labrun.gap.next.trials import PlannedTrial, planned_data

_NEXT_TRIALS = (2, 4)
"""Fewest and most trials that are proposed."""
_PREDICTED_APART = 0.3
"""Difference between rivals, in units of what the outputs do, beyond which a fit may not find its way."""
_SEPARATED = 1.5
"""Evidence, in margins of the rule, at which two explanations are expected to be told apart: the forecast is of first
order, and may be off by half of a margin."""
_ENOUGH = 2 * _SEPARATED
"""Evidence, in margins of the rule, at which no further trial is needed."""
_HOPELESS_EVIDENCE = 0.1
"""Evidence below which a pair has no part in the choice, and trials are not worth their time."""


def greedy(
    value: Callable[[Sequence[int]], float],
    cost: Sequence[float],
    least_gain: Callable[[float], float],
    enough: Callable[[Sequence[int]], bool] = lambda _: False,
) -> list[int]:
    """Add the trial that raises a value most for its cost, until another adds too little or there is enough.

    Parameters
    ----------
    value
        Of chosen trials, by their numbers.
    cost
        Of every trial.
    least_gain
        What a further trial has to add to a value.
    """
    chosen: list[int] = []
    so_far = value(chosen)
    fewest, most = _NEXT_TRIALS
    while len(chosen) < min(most, len(cost)):
        rest = [index for index in range(len(cost)) if index not in chosen]
        gains = [value([*chosen, index]) - so_far for index in rest]
        at = int(np.argmax([gain / cost[index] for gain, index in zip(gains, rest, strict=True)]))
        if len(chosen) >= fewest and gains[at] <= least_gain(so_far):
            break
        chosen.append(rest[at])
        so_far += gains[at]
        if len(chosen) >= fewest and enough(chosen):
            break
    return chosen


@dataclass(frozen=True)
class Evidence:
    """What trials would say if one explanation were true and another were fitted to it.

    Attributes
    ----------
    squares
        Expected sum of squared differences, in units of the noise of each trial's mean, that the other leaves.
    fall
        Expected difference of the log errors of the two over all units of evidence, recorded and planned, less its
        standard error: what the rule of `labrun.gap.decide` compares with its margin.
    is_simpler
        Whether the truth has fewer variables than its rival: of two that predict alike, the simpler one leads.
    """

    truth: str
    rival: str
    squares: float
    fall: float
    is_simpler: bool

    @property
    def sigma(self) -> float:
        """Standard deviations by which the wrong one, fitted to everything, would miss."""
        return float(np.sqrt(max(self.squares, 0.0)))

    @property
    def ratio(self) -> float:
        """Expected fall of the log error over the margin of the rule; above 1 the data would decide."""
        return self.fall / criteria.MARGIN

    @property
    def told_apart(self) -> bool:
        """Whether a diagnosis is expected to decide between the two."""
        return self.is_simpler or self.ratio >= _SEPARATED

    @property
    def by_simplicity(self) -> bool:
        """Whether the rival would explain it as well, and loses for having more parameters."""
        return self.is_simpler and self.ratio < _SEPARATED


def hopeless(pairs: Sequence[Evidence]) -> bool:
    """Tell whether trials say next to nothing of any pair."""
    return all(
        evidence.sigma < criteria.VISIBLE_DIFFERENCE or evidence.ratio < _HOPELESS_EVIDENCE
        for evidence in pairs
    )


class Separation:
    """Evidence of any choice of trials from a pool, on the stored fits.

    A rival's parameters, effect sizes and initial states move to imitate the truth, to first order, as far as the
    recorded data let them; what they cannot imitate is the expected squared separation. Each planned trial is a unit of
    evidence beside the recorded ones, whose errors are known. Trials that any rival cannot simulate are left out.

    Parameters
    ----------
    repeats
        Of each trial.
    """

    def __init__(self, rivals: Rivals, dataset: Dataset, pool: Sequence[PlannedTrial], repeats: int) -> None:
        self.rivals, self._repeats = rivals, repeats
        everyone = list(dict.fromkeys([*rivals.rivals, rivals.null]))
        simulated = list(zip(*(predict(rival, dataset, pool) for rival in everyone), strict=True))
        usable = [k for k, outputs in enumerate(simulated) if all(each is not None for each in outputs)]
        self.trials = [pool[k] for k in usable]
        self._predicted = {
            rival: [outputs for k in usable if (outputs := simulated[k][column]) is not None]
            for column, rival in enumerate(everyone)
        }
        data = {
            rival: planned_data(dataset, self.trials, self._predicted[rival], repeats) for rival in everyone
        }
        self._recorded = {rival: Recorded(rival.problem, rival.z) for rival in everyone}
        self._imitation, self._changes = dict[Rival, Imitation](), dict[tuple[Rival, Rival], Change]()
        for other in everyone:
            z = np.concatenate([other.shared, beginnings(other, self.trials).ravel()])
            planned, known = other.problem.on(data[other]), self._recorded[other].information
            self._imitation[other] = Imitation(planned, z, known, central=False)
            for truth in rivals.rivals:
                if truth is not other:
                    missed = planned.on(data[truth]).residuals(z)
                    self._changes[truth, other] = self._imitation[other].change(missed)

    def evidence(self, chosen: Sequence[int]) -> list[Evidence]:
        """Return what these trials of `trials` would say, pair by pair as in `Rivals.pairs`."""
        return [self._evidence(truth, other, chosen) for truth, other in self.rivals.pairs]

    def _evidence(self, truth: Rival, other: Rival, chosen: Sequence[int]) -> Evidence:
        moved, separation = self._separation(truth, other, chosen)
        _, gap = self._separation(truth, self.rivals.null, chosen)
        usual = np.mean(truth.error.squares, axis=0) + (1.0 if self.rivals.noise.known else 0.0)
        scale = np.square(other.problem.noise.weights * self.rivals.noise.sd)
        logs = self.rivals.by_condition(truth.error.log)
        recorded = self._recorded[other].errors(moved)
        falls = (
            self.rivals.by_condition(other.error.log)
            - logs
            + np.log1p(recorded / np.mean(scale) / np.exp(logs))
        )
        blocks = -(-criteria.ENOUGH_UNITS // (len(falls) + len(chosen)))
        planned = [
            np.mean(
                [
                    np.log1p(np.mean(block, axis=0) / scale / (usual + criteria.NEGLIGIBLE**2 * whole))
                    for block in np.array_split(squares, min(blocks, len(squares)))
                ]
            )
            for squares, whole in zip(
                separation, [np.mean(each, axis=0) / scale for each in gap], strict=True
            )
        ]
        falls = np.array([*falls, *planned])
        comparison = decide.compare(falls, np.zeros(len(falls)), np.arange(len(falls)))
        # the scatter of a single planned trial is not known yet: it is no reason to plan none
        fall = comparison.mean - (comparison.standard_error if len(chosen) > 1 else 0.0)
        squares = self._repeats * float(np.sum([np.sum(each) for each in separation]))
        return Evidence(truth.name, other.name, squares, fall, truth.variables < other.variables)

    def _separation(
        self, truth: Rival, other: Rival, chosen: Sequence[int]
    ) -> tuple[FloatArray, list[FloatArray]]:
        """Return how far a rival's parameters move, and the squares (n, m) that it leaves of each chosen trial.

        Squares are those of one trial, in units of the noise.
        """
        shapes = [self._predicted[truth][index].shape for index in chosen]
        if truth is other:
            return np.zeros(other.problem.size), [np.zeros(shape) for shape in shapes]
        imitation, change = self._imitation[other], self._changes[truth, other]
        moved = imitation.moved(change, chosen)
        parts = imitation.remainder(change, chosen, moved)
        return moved, [
            np.square(part[: rows * columns].reshape(rows, columns)) / self._repeats
            for part, (rows, columns) in zip(parts, shapes, strict=True)
        ]

    def doubt(self, index: int) -> float:
        """Return by how much less a trial's evidence is to be believed, as a factor of at least 1.

        Models were found to hold where they were measured, not beyond; and where rivals predict quite different things
        the first order cannot be trusted to find the best imitation.
        """
        first, *others = (self._predicted[rival][index] for rival in self.rivals.rivals)
        spread = np.maximum(np.std(first, axis=0), 1e-300)
        apart = max(
            float(np.max(np.sqrt(np.mean(np.square(outputs - first), axis=0)) / spread)) for outputs in others
        )
        return max(1.0, apart / _PREDICTED_APART) ** 2 * self.trials[index].reach ** 2

    def choose(self) -> list[int]:
        """Return a few trials: the cheapest way first, and whatever separates best if that does not decide.

        Trials are added until every pair has `_ENOUGH` times the evidence that a diagnosis asks for. What one pair has
        beyond it does not make up for another; pairs that no trials of the pool can separate do not count.
        """
        every = range(len(self.trials))
        if not every:
            return []
        alone = [self.evidence([k]) for k in every]
        most = [max(each.ratio for each in pair) for pair in zip(*alone, strict=True)]
        hopeful = [pair for pair, ratio in enumerate(most) if ratio >= _HOPELESS_EVIDENCE]

        def ratios(chosen: Sequence[int]) -> list[float]:
            evidence = self.evidence(chosen)
            return [evidence[pair].ratio for pair in hopeful or range(len(most))]

        def value(chosen: Sequence[int]) -> float:
            capped = [min(max(ratio, -1.0), _ENOUGH) for ratio in ratios(chosen)]
            return sum(capped) + len(capped) * min(capped)

        def greedily(dear: float) -> list[int]:
            cost = [self.doubt(k) * trial.cost_s**dear for k, trial in enumerate(self.trials)]
            return greedy(
                value,
                cost,
                lambda so_far: 0.02 * max(so_far, 1e-12),
                lambda chosen: min(ratios(chosen)) >= _ENOUGH,
            )

        cheap = greedily(1.0)
        return cheap if min(ratios(cheap)) >= _SEPARATED else max(cheap, greedily(0.0), key=value)


def predict(rival: Rival, dataset: Dataset, trials: Sequence[PlannedTrial]) -> list[FloatArray | None]:
    """Return the outputs that an explanation predicts for new trials; None where it diverges."""
    if not trials:
        return []
    blank = [np.zeros((len(trial.time_s), len(dataset.outputs))) for trial in trials]
    problem = rival.problem.on(planned_data(dataset, trials, blank, 1))
    parameters = problem.parameters(rival.shared)
    return [problem.simulate(parameters, k, own) for k, own in enumerate(beginnings(rival, trials))]


def beginnings(rival: Rival, trials: Sequence[PlannedTrial]) -> FloatArray:
    """Return the scaled free initial states that new trials would have, shape (trials, states).

    Where a trial begins depends on its condition: a body that is let go at an angle begins there. The dependence is
    taken from the states that were fitted to the measured trials, linear in the conditions.
    """
    own = rival.own
    if own.shape[1] == 0:
        return np.empty((len(trials), 0))
    measured = [unit.condition for unit in rival.problem.data.trials]
    names = _numbers(measured)
    known = _features(measured, names)
    coefficients = np.linalg.lstsq(known, own, rcond=1e-9)[0]
    predicted = _features([trial.condition for trial in trials], names, measured) @ coefficients
    for index, trial in enumerate(trials):
        if trial.like is not None:
            unit, factor = trial.like
            predicted[index] = own[unit] * factor
    return np.asarray(predicted)


def _numbers(conditions: Sequence[Mapping[str, float | str]]) -> list[str]:
    """Return the names of the numbers that differ between conditions; all numbers if only one was measured."""
    first = conditions[0]
    names = [
        name
        for name in first
        if all(
            isinstance(condition.get(name), float | int) and not isinstance(condition[name], bool)
            for condition in conditions
        )
    ]
    varying = [name for name in names if len({condition[name] for condition in conditions}) > 1]
    return varying or names


def _features(
    conditions: Sequence[Mapping[str, float | str]],
    names: Sequence[str],
    measured: Sequence[Mapping[str, float | str]] | None = None,
) -> FloatArray:
    """Return the numbers of the conditions, and a constant where enough different ones were measured to tell it."""
    known = conditions if measured is None else measured
    different = {tuple(condition[name] for name in names) for condition in known}
    columns = [np.array([float(condition.get(name, 0.0)) for condition in conditions]) for name in names]
    if len(different) > len(names) + 1 or not names:
        columns.append(np.ones(len(conditions)))
    return np.column_stack(columns)
