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
from labrun.gap.rating import Rated
from labrun.gap.screening import refit

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
    squares
        Sum of squared residuals on the data, prior included.
    slack
        How far its idealised form is to be believed: the part of what it is to explain that it leaves.
    """

    name: str
    cause: Name | None
    problem: Problem
    z: FloatArray
    variables: int
    squares: float
    slack: float = criteria.IDEALISED_FORM[1]

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
    dispersion
        Energy of the noise in one direction, as the guard found it; 1 for white noise.
    """

    rivals: tuple[Rival, ...]
    null: Rival
    doubt: bool
    why: str
    dispersion: float

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
    first = selection.rounds[0]
    null = Rival(NOTHING, None, first.base.problem, first.base.z, 0, first.base.squares)

    def told(found: Sequence[Rival], doubt: bool, why: str) -> Rivals:
        return Rivals(tuple(found), null, doubt, why, first.threshold.dispersion)

    # several doubtful causes: the one taken in last stands beside all others
    doubtful = [cause for cause in selection.chosen if cause.doubts]
    if doubtful:
        explanations = (doubtful[-1].rated, *doubtful[-1].doubts)[: criteria.MOST_EXPLANATIONS]
        found = [_fitted(one, null) for one in explanations]
        names = " or ".join(one.name for one in found[1:])
        return told(found, True, f"The data cannot tell {found[0].name} from {names}.")
    if not selection.chosen:
        ranked = [_fitted(one, null) for one in selection.rounds[-1].rated[:2]]
        why = "No cause was named: the best candidates are held against recalibration alone."
        return told([*ranked, null], False, why)
    cause = selection.chosen[-1].rated
    others = [one for one in first.rated if one.candidate.name != cause.candidate.name and one.evidence > 1.0]
    best = _fitted(cause, null)
    if len(selection.chosen) == 1 and others:
        second = _fitted(max(others, key=lambda one: one.score), null)
        against = f"the runner-up, {second.name}"
    else:
        second, against = null, null.name
    return told(
        [best, second], False, f"The diagnosis is not in doubt: {best.name} is held against {against}."
    )


def _fitted(rated: Rated, null: Rival) -> Rival:
    problem, candidate = rated.screened.problem, rated.candidate
    z = refit(problem, rated.screened.z)
    squares = problem.squares(z)
    gain = null.squares - squares
    rows = sum(part.size for part in problem.residuals(z))
    left = max(squares - rows, 0.0) / gain if gain > 0 else 1.0
    slack = float(np.clip(left, *criteria.IDEALISED_FORM))
    return Rival(str(candidate.name), candidate.name, problem, z, candidate.variables, squares, slack)


_TOLERANCE = 1e-5
_EVALUATIONS = 40


@dataclass(frozen=True)
class Evidence:
    """What trials would say if one explanation were true and another were fitted to it.

    Attributes
    ----------
    squares
        Expected sum of squared residuals, in units of the noise, that the other leaves.
    gain
        The same of the model without any effect: how far the truth shows at all.
    dispersion
        Of the noise, see `Rivals`.
    price
        Log likelihood that the truth has to earn first, for having more variables than its rival; negative if it has
        fewer.
    slack
        Part of the gain that the truth's idealised form may lack, see `Rival`.
    """

    truth: str
    rival: str
    squares: float
    gain: float
    dispersion: float
    price: float
    slack: float

    @property
    def log_likelihood(self) -> float:
        """Expected logarithm of the likelihood ratio."""
        return 0.5 * self.squares / self.dispersion

    @property
    def sigma(self) -> float:
        """Standard deviations by which the wrong one, fitted to everything, would miss."""
        return float(np.sqrt(max(2.0 * self.log_likelihood, 0.0)))

    @property
    def ratio(self) -> float:
        """Expected log likelihood over what a diagnosis asks for before it names one of the two alone; above 1 it does.

        Forms of effects are idealised: the more an effect shows, the larger the difference that counts. `TOLD_APART`
        leaves room for errors of sizes and parameters.
        """
        softness = max(1.0, self.slack * 0.5 * self.gain / self.dispersion / 3.0)
        return (self.log_likelihood - self.price) / (criteria.CLEARLY_LESS_LIKELY * softness)

    @property
    def told_apart(self) -> bool:
        """Tell whether a diagnosis is expected to decide between the two."""
        return self.ratio >= criteria.TOLD_APART

    @property
    def by_simplicity(self) -> bool:
        """Tell whether the rival would explain it as well, and is dropped for having more parameters."""
        return self.told_apart and self.sigma < criteria.CLEARLY_SEEN


def hopeless(evidence: Sequence[Evidence]) -> bool:
    """Tell whether trials say next to nothing of any pair."""
    return all(
        one.sigma < criteria.VISIBLE_DIFFERENCE or one.ratio < criteria.HOPELESS_EVIDENCE for one in evidence
    )


def _evidence(
    rivals: Rivals, squares: Callable[[Rival, Rival], float], gain: Callable[[Rival], float]
) -> list[Evidence]:
    """Return the evidence pair by pair as in `Rivals.pairs`, from what rivals leave of each other."""
    return [
        Evidence(
            truth.name,
            other.name,
            squares(truth, other),
            0.0 if truth is rivals.null else gain(truth),
            rivals.dispersion,
            criteria.VARIABLE_PRICE * (max(truth.variables, 1) - max(other.variables, 1)),
            truth.slack,
        )
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
        null = self.rivals.null

        def squares(truth: Rival, other: Rival) -> float:
            return self._imitation[other].left(self._changes[truth, other], chosen)

        return _evidence(
            self.rivals,
            squares,
            lambda truth: max(null.squares - truth.squares, 0.0) + squares(truth, null),
        )

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
        return max(1.0, apart / criteria.PREDICTED_APART) ** 2 * self.trials[index].reach ** 2

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
        hopeful = [pair for pair, ratio in enumerate(most) if ratio >= criteria.HOPELESS_EVIDENCE]

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
        return cheap if min(ratios(cheap)) >= criteria.TOLD_APART else max(cheap, greedily(0.0), key=value)


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

    return _evidence(rivals, squares, lambda truth: squares(truth, rivals.null))


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
