"""How far trials would tell explanations apart, once each has been fitted to what the others predict (T-optimality)."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, Problem, minimise
from labrun.gap import criteria
from labrun.gap.diagnosis import Name
from labrun.gap.next.imitation import Change, Imitation, greedy, information
from labrun.gap.next.trials import PlannedTrial, planned_data
from labrun.gap.pipeline import Search
from labrun.gap.selection import CauseSet

_MOST_EXPLANATIONS = 6
"""Explanations that are held against one another."""
_PREDICTED_APART = 0.3
"""Difference between rivals, in units of what the outputs do, beyond which a fit may not find its way."""
_TOLD_APART = 1.5
"""Evidence, over what a diagnosis asks for, at which two explanations are expected to be told apart."""
_HOPELESS_EVIDENCE = 0.1
"""Evidence of the whole pool below which a pair has no part in the choice, and trials are not worth their time."""

NOTHING = "recalibration only"


@dataclass(frozen=True, eq=False)
class Rival:
    """One explanation of the data.

    Attributes
    ----------
    name
        What is special about it, for people.
    cause
        None for the recalibrated model without any effect.
    variables
        Number of variables that its cause adds.
    """

    name: str
    cause: Name | None
    problem: Problem
    z: FloatArray
    variables: int

    @property
    def shared(self) -> FloatArray:
        """Scaled parameters and effect sizes."""
        return self.z[: self.problem.size]

    @property
    def own(self) -> FloatArray:
        """Scaled free initial states, shape (units, states)."""
        return self.z[self.problem.size :].reshape(len(self.problem.data.trials), self.problem.own_size)

    @property
    def sizes(self) -> dict[str, float]:
        """Parameters of its own effect by name, SI; empty for a parameter or without a cause."""
        if self.cause is None or self.cause.kind == "parameter":
            return {}
        attached = self.problem.attached(self.problem.parameters(self.z))
        mine = [one for one in attached if (one.effect.id, one.site) == (self.cause.effect, self.cause.site)]
        return dict(mine[-1].named_values) if mine else {}


@dataclass(frozen=True)
class Rivals:
    """What is to be told apart.

    Attributes
    ----------
    rivals
        The most probable first.
    null
        The recalibrated model: what each of them is an improvement on.
    doubt
        Whether the diagnosis itself could not tell them apart; else the cause is held against its runner-up.
    why
        What is compared with what, as a sentence.
    """

    rivals: tuple[Rival, ...]
    null: Rival
    doubt: bool
    why: str

    @property
    def pairs(self) -> list[tuple[Rival, Rival]]:
        """Every two of them, each once as the truth and once as its rival."""
        return [(one, other) for one in self.rivals for other in self.rivals if one is not other]


def rivals_of(search: Search) -> Rivals:
    """Return the explanations that a search leaves, fitted again closely.

    Where the diagnosis is in doubt these are the cause and what cannot be told from it. Where it is not, the cause is
    held against the runner-up, or against recalibration alone if there is none.
    """
    selection = search.selection
    reference = selection.reference.base
    null = Rival(NOTHING, None, reference.problem, reference.z, 0)
    last = selection.steps[-1]
    # several doubtful causes: the one that closes least stands beside all others
    doubtful = [cause for cause in selection.chosen if cause.rivals]
    if doubtful:
        cause = doubtful[-1]
        rivals = [
            _named(cause.name, last),
            *(_named(entry.candidates[-1].name, entry) for entry in cause.rivals),
        ]
        rivals = rivals[:_MOST_EXPLANATIONS]
        names = " or ".join(rival.name for rival in rivals[1:])
        why = f"The data do not separate {rivals[0].name} from {names}."
        return Rivals(tuple(rivals), null, True, why)
    judged = [] if selection.first is None else selection.first.extended
    if not selection.chosen:
        best = [_named(entry.candidates[-1].name, entry) for entry in judged[:2]]
        why = "No cause was named: the best candidates are compared with recalibration alone."
        return Rivals((*best, null), null, False, why)
    cause = selection.chosen[-1]
    others = [entry for entry in judged if entry.names != last.names]
    if len(selection.chosen) == 1 and others:
        second = _named(others[0].candidates[-1].name, others[0])
        against = f"the runner-up, {second.name}"
    else:
        second, against = null, null.name
    first = _named(cause.name, last)
    why = f"The diagnosis is not in doubt: {first.name} is compared with {against}."
    return Rivals((first, second), null, False, why)


def _named(name: Name, model: CauseSet) -> Rival:
    variables = sum(candidate.variables for candidate in model.candidates)
    return Rival(str(name), name, model.base.problem, model.base.z, variables)


_TOLERANCE = 1e-5
_EVALUATIONS = 40


@dataclass(frozen=True)
class Evidence:
    """What trials would say if one explanation were true and another were fitted to it.

    Attributes
    ----------
    squares
        Expected sum of squared residuals, in units of the noise, that the other leaves of the trials.
    samples
        Number of residuals of these trials.
    is_simpler
        Whether the truth has fewer variables than its rival: of two that predict alike, the simpler one leads.
    """

    truth: str
    rival: str
    squares: float
    samples: int
    is_simpler: bool

    @property
    def sigma(self) -> float:
        """Standard deviations by which the wrong one, fitted to everything, would miss."""
        return float(np.sqrt(max(self.squares, 0.0)))

    @property
    def ratio(self) -> float:
        """Expected difference of the log errors over the margin of the rule; above 1 the data would decide."""
        return float(np.log1p(max(self.squares, 0.0) / max(self.samples, 1))) / criteria.MARGIN

    @property
    def told_apart(self) -> bool:
        """Whether a diagnosis is expected to decide between the two."""
        return self.is_simpler or self.ratio >= _TOLD_APART

    @property
    def by_simplicity(self) -> bool:
        """Whether the rival would explain it as well, and loses for having more parameters."""
        return self.is_simpler and self.ratio < _TOLD_APART


def hopeless(pairs: Sequence[Evidence]) -> bool:
    """Tell whether trials say next to nothing of any pair."""
    return all(
        evidence.sigma < criteria.VISIBLE_DIFFERENCE or evidence.ratio < _HOPELESS_EVIDENCE
        for evidence in pairs
    )


def _evidence(rivals: Rivals, squares: Callable[[Rival, Rival], float], samples: int) -> list[Evidence]:
    """Return the evidence pair by pair as in `Rivals.pairs`, from what rivals leave of each other."""
    return [
        Evidence(truth.name, other.name, squares(truth, other), samples, truth.variables < other.variables)
        for truth, other in rivals.pairs
    ]


class Separation:
    """Evidence of any choice of trials from a pool, to first order.

    A rival's parameters, effect sizes and initial states move to imitate the truth as far as the data that are there
    already let them; what they cannot imitate counts. Trials that any rival cannot simulate are left out.

    Parameters
    ----------
    repeats
        Of each trial.
    """

    def __init__(self, rivals: Rivals, dataset: Dataset, pool: Sequence[PlannedTrial], repeats: int) -> None:
        self.rivals = rivals
        everyone = list(dict.fromkeys([*rivals.rivals, rivals.null]))
        simulated = list(zip(*(predict(one, dataset, pool) for one in everyone), strict=True))
        usable = [k for k, outputs in enumerate(simulated) if all(one is not None for one in outputs)]
        self.trials = [pool[k] for k in usable]
        self._predicted = {
            one: [found for k in usable if (found := simulated[k][place]) is not None]
            for place, one in enumerate(everyone)
        }
        data = {one: planned_data(dataset, self.trials, self._predicted[one], repeats) for one in everyone}
        self._samples = [predicted.size for predicted in self._predicted[rivals.null]]
        self._imitation, self._changes = dict[Rival, Imitation](), dict[tuple[Rival, Rival], Change]()
        for other in everyone:
            z = np.concatenate([other.shared, beginnings(other, self.trials).ravel()])
            known = information(other.problem, other.z)
            imitation = Imitation(other.problem.on(data[other]), z, known, central=False)
            self._imitation[other] = imitation
            for truth in rivals.rivals:
                if truth is not other:
                    missed = other.problem.on(data[truth]).residuals(z)
                    self._changes[truth, other] = imitation.change(missed)

    def evidence(self, chosen: Sequence[int]) -> list[Evidence]:
        """Return what these trials of `trials` would say, pair by pair as in `Rivals.pairs`."""

        def squares(truth: Rival, other: Rival) -> float:
            return self._imitation[other].left(self._changes[truth, other], chosen)

        samples = sum(self._samples[index] for index in chosen)
        return _evidence(self.rivals, squares, samples)

    def doubt(self, index: int) -> float:
        """Return by how much less a trial's evidence is to be believed, as a factor of at least 1.

        Models were found to hold where they were measured, not beyond; and where rivals predict quite different things
        neither the first order nor a fit can be trusted to find the best imitation.
        """
        outputs = [self._predicted[one][index] for one in self.rivals.rivals]
        does = np.maximum(np.std(outputs[0], axis=0), 1e-300)
        apart = max(
            float(np.max(np.sqrt(np.mean(np.square(one - outputs[0]), axis=0)) / does)) for one in outputs[1:]
        )
        return max(1.0, apart / _PREDICTED_APART) ** 2 * self.trials[index].reach ** 2

    def choose(self, enough: float) -> list[int]:
        """Return a few trials: the cheapest way first, and whatever separates best if that does not decide.

        Parameters
        ----------
        enough
            Evidence of every pair, over what a diagnosis asks for, at which no further trial is taken in. What one
            pair has beyond it does not make up for another; pairs that no trials of the pool can separate do not count.
        """
        every = range(len(self.trials))
        if not every:
            return []
        looks = [self.evidence(one) for one in (*([k] for k in every), every)]
        most = [max(one.ratio for one in pair) for pair in zip(*looks, strict=True)]
        hopeful = [pair for pair, ratio in enumerate(most) if ratio >= _HOPELESS_EVIDENCE]

        def ratios(chosen: Sequence[int]) -> list[float]:
            found = self.evidence(chosen)
            return [found[pair].ratio for pair in hopeful or range(len(most))]

        def value(chosen: Sequence[int]) -> float:
            each = [min(max(one, -1.0), enough) for one in ratios(chosen)]
            return sum(each) + len(each) * min(each)

        def greedily(dear: float) -> list[int]:
            cost = [self.doubt(k) * trial.cost_s**dear for k, trial in enumerate(self.trials)]
            return greedy(
                value,
                cost,
                lambda so_far: 0.02 * max(so_far, 1e-12),
                lambda chosen: min(ratios(chosen)) >= enough,
            )

        cheap = greedily(1.0)
        return cheap if min(ratios(cheap)) >= _TOLD_APART else max(cheap, greedily(0.0), key=value)


def predict(rival: Rival, dataset: Dataset, trials: Sequence[PlannedTrial]) -> list[FloatArray | None]:
    """Return the outputs that an explanation predicts for new trials; None where it leaves the finite numbers."""
    if not trials:
        return []
    blank = [np.zeros((len(trial.time_s), len(dataset.outputs))) for trial in trials]
    problem = rival.problem.on(planned_data(dataset, trials, blank, 1))
    parameters = problem.parameters(rival.shared)
    return [problem.simulate(parameters, k, own) for k, own in enumerate(beginnings(rival, trials))]


def rehearse(
    rivals: Rivals, dataset: Dataset, trials: Sequence[PlannedTrial], repeats: int
) -> list[Evidence]:
    """Return what old and new trials together would say, pair by pair, with every rival really fitted to the other."""

    @cache
    def squares(truth: Rival, other: Rival) -> float:
        return fitted_squares(truth, other, dataset, trials, repeats)

    samples = sum(len(trial.time_s) for trial in trials) * len(dataset.outputs)
    return _evidence(rivals, squares, samples)


def fitted_squares(
    truth: Rival, other: Rival, dataset: Dataset, trials: Sequence[PlannedTrial], repeats: int
) -> float:
    """Return what `other` leaves, fitted to everything that `truth` predicts for old and new trials."""
    outputs = [one for one in predict(truth, dataset, trials) if one is not None]
    old = truth.problem.with_measured(truth.problem.simulated(truth.z)).data
    new = planned_data(dataset, trials, outputs, repeats, after=len(old.conditions))
    both = replace(old, trials=(*old.trials, *new.trials), conditions=(*old.conditions, *new.conditions))
    problem = other.problem.on(both)
    z = np.concatenate([other.z, beginnings(other, trials).ravel()])
    end = minimise(problem, z, tolerance=_TOLERANCE, evaluations=_EVALUATIONS, central=False)
    prior = truth.problem.priors.residual(truth.z)
    return max(problem.squares(end) - float(prior @ prior), 0.0)


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
            isinstance(one.get(name), float | int) and not isinstance(one[name], bool) for one in conditions
        )
    ]
    varying = [name for name in names if len({one[name] for one in conditions}) > 1]
    return varying or names


def _features(
    conditions: Sequence[Mapping[str, float | str]],
    names: Sequence[str],
    measured: Sequence[Mapping[str, float | str]] | None = None,
) -> FloatArray:
    """Return the numbers of the conditions, and a constant where enough different ones were measured to tell it."""
    known = conditions if measured is None else measured
    different = {tuple(one[name] for name in names) for one in known}
    columns = [np.array([float(one.get(name, 0.0)) for one in conditions]) for name in names]
    if len(different) > len(names) + 1 or not names:
        columns.append(np.ones(len(conditions)))
    return np.column_stack(columns)
