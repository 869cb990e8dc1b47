"""How far trials would tell explanations apart, once each has been fitted to what the others predict (T-optimality)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Dataset, Problem, minimise
from labrun.gap import criteria
from labrun.gap.diagnosis import Name
from labrun.gap.next.trials import PlannedTrial, joined, planned_data
from labrun.gap.nuisance import basis
from labrun.gap.pipeline import Search
from labrun.gap.rating import Rated
from labrun.gap.screening import refit
from labrun.gap.selection import Round

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
    """

    name: str
    cause: Name | None
    problem: Problem
    z: FloatArray
    variables: int
    squares: float

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
    base = selection.rounds[0].base
    null = Rival(NOTHING, None, base.problem, base.z, 0, base.squares)
    dispersion = selection.rounds[0].threshold.dispersion
    doubtful = [(cause.rated, cause.doubts) for cause in selection.chosen if cause.doubts]
    if doubtful:
        # several doubtful causes: the one taken in last stands beside all others
        cause, others = doubtful[-1]
        found = [_fitted(one) for one in (cause, *others)][: criteria.MOST_EXPLANATIONS]
        names = " or ".join(one.name for one in found[1:])
        return Rivals(
            tuple(found), null, True, f"The data cannot tell {found[0].name} from {names}.", dispersion
        )
    if selection.chosen:
        cause = selection.chosen[-1].rated
        runner_up = _runner_up(selection.rounds[0], cause) if len(selection.chosen) == 1 else None
        found = [_fitted(cause), null if runner_up is None else _fitted(runner_up)]
        why = f"The diagnosis is not in doubt: {found[0].name} is held against {_as_runner_up(found[1])}."
        return Rivals(tuple(found), null, False, why, dispersion)
    ranked = selection.rounds[-1].rated
    found = [*(_fitted(one) for one in ranked[:2]), null]
    why = "No cause was named: the best candidates are held against recalibration alone."
    return Rivals(tuple(found), null, False, why, dispersion)


def _as_runner_up(rival: Rival) -> str:
    return f"the runner-up, {rival.name}" if rival.cause is not None else rival.name


def _runner_up(look: Round, cause: Rated) -> Rated | None:
    others = [one for one in look.rated if one.candidate.name != cause.candidate.name and one.evidence > 1.0]
    return max(others, key=lambda one: one.score, default=None)


def _fitted(rated: Rated) -> Rival:
    screened = rated.screened
    z = refit(screened.problem, screened.z)
    candidate = rated.candidate
    squares = screened.problem.squares(z)
    return Rival(str(candidate.name), candidate.name, screened.problem, z, candidate.variables, squares)


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
        Part of the gain that the truth's idealised form may lack, see `slack`.
    """

    squares: float
    gain: float
    dispersion: float
    price: float
    slack: float = criteria.IDEALISED_FORM[1]

    @property
    def log_likelihood(self) -> float:
        """Expected logarithm of the likelihood ratio."""
        return 0.5 * self.squares / self.dispersion

    @property
    def sigma(self) -> float:
        """The same as a number of standard deviations."""
        return float(np.sqrt(max(2.0 * self.log_likelihood, 0.0)))

    @property
    def ratio(self) -> float:
        """Expected log likelihood over what a diagnosis asks for before it names one of the two alone; above 1 it does.

        Forms of effects are idealised: the more an effect shows, the larger the difference that counts.
        """
        softness = max(1.0, self.slack * 0.5 * self.gain / self.dispersion / 3.0)
        return (self.log_likelihood - self.price) / (criteria.CLEARLY_LESS_LIKELY * softness)


def slack(truth: Rival, null: Rival) -> float:
    """Return how far the form of an explanation is to be believed: as much as it leaves of what it is to explain."""
    gain = null.squares - truth.squares
    rows = sum(part.size for part in truth.problem.residuals(truth.z))
    left = max(truth.squares - rows, 0.0) / gain if gain > 0 else 1.0
    return float(np.clip(left, *criteria.IDEALISED_FORM))


def price(truth: Rival, other: Rival) -> float:
    """Return what `truth` must earn for its further variables."""
    return criteria.VARIABLE_PRICE * (max(truth.variables, 1) - max(other.variables, 1))


class Separation:
    """Evidence of any choice of trials from a pool, to first order.

    A rival's parameters, effect sizes and initial states move to imitate the truth as far as the data that are there
    already let them; what they cannot imitate counts (Atkinson and Fedorov, Biometrika 62, 1975). Trials that any
    rival cannot simulate are left out.

    Parameters
    ----------
    repeats
        Of each trial.
    """

    def __init__(self, rivals: Rivals, dataset: Dataset, pool: Sequence[PlannedTrial], repeats: int) -> None:
        self.rivals = rivals
        everyone = _with_null(rivals)
        outputs = {id(one): predict(one, dataset, pool) for one in everyone}
        usable = [k for k in range(len(pool)) if all(outputs[id(one)][k] is not None for one in everyone)]
        self.trials = [pool[k] for k in usable]
        self.predicted: dict[int, list[FloatArray]] = {
            id(one): [found for k in usable if (found := outputs[id(one)][k]) is not None] for one in everyone
        }
        self._slack = {id(one): slack(one, rivals.null) for one in everyone}
        self._information = {id(one): information(one) for one in everyone}
        self._slopes: dict[int, tuple[list[FloatArray], list[FloatArray]]] = {}
        self._units = {
            id(one): planned_data(dataset, self.trials, self.predicted[id(one)], repeats) for one in everyone
        }
        for one in everyone:
            problem = one.problem.on(self._units[id(one)])
            blocks = problem.jacobian(self._z(one), central=False)
            spans = [basis(own) for own in blocks.own]
            rows = [_off(span, shared) for span, shared in zip(spans, blocks.shared, strict=True)]
            self._slopes[id(one)] = (spans, rows)
        self._left = {
            (id(truth), id(other)): self._residual(truth, other)
            for truth in rivals.rivals
            for other in everyone
            if other is not truth
        }

    def evidence(self, chosen: Sequence[int]) -> list[Evidence]:
        """Return what these trials of `trials` would say, pair by pair as in `Rivals.pairs`."""
        found = []
        null = self.rivals.null
        for truth, other in self.rivals.pairs:
            shows = truth is not null
            more = self._squares(truth, null, chosen) if shows else 0.0
            gain = max(null.squares - truth.squares, 0.0) + more if shows else 0.0
            squares = self._squares(truth, other, chosen)
            found.append(
                Evidence(squares, gain, self.rivals.dispersion, price(truth, other), self._slack[id(truth)])
            )
        return found

    def doubt(self, index: int) -> float:
        """Return by how much less a trial's evidence is to be believed, as a factor of at least 1.

        Models were found to hold where they were measured, not beyond; and where rivals predict quite different things
        neither the first order nor a fit can be trusted to find the best imitation.
        """
        outputs = [self.predicted[id(one)][index] for one in self.rivals.rivals]
        does = np.maximum(np.std(outputs[0], axis=0), 1e-300)
        apart = max(
            float(np.max(np.sqrt(np.mean(np.square(one - outputs[0]), axis=0)) / does)) for one in outputs[1:]
        )
        return max(1.0, apart / criteria.PREDICTED_APART) ** 2 * self.trials[index].reach ** 2

    def _z(self, rival: Rival) -> FloatArray:
        return np.concatenate([rival.shared, beginnings(rival, self.trials).ravel()])

    def _residual(self, truth: Rival, other: Rival) -> list[FloatArray]:
        parts = other.problem.on(self._units[id(truth)]).residuals(self._z(other))
        return [_off(span, part) for span, part in zip(self._slopes[id(other)][0], parts, strict=True)]

    def _squares(self, truth: Rival, other: Rival, chosen: Sequence[int]) -> float:
        """Return the least sum of squares that `other` can reach on the chosen trials without spoiling its fit."""
        if truth is other or not chosen:
            return 0.0
        left, rows = self._left[id(truth), id(other)], self._slopes[id(other)][1]
        total = self._information[id(other)].copy()
        pull = np.zeros(len(total))
        squares = 0.0
        for k in chosen:
            total += rows[k].T @ rows[k]
            pull += rows[k].T @ left[k]
            squares += float(left[k] @ left[k])
        scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-300))
        moved = np.linalg.lstsq(total * scale[:, None] * scale, pull * scale, rcond=1e-12)[0]
        return max(squares - float(pull * scale @ moved), 0.0)


def predict(rival: Rival, dataset: Dataset, trials: Sequence[PlannedTrial]) -> list[FloatArray | None]:
    """Return the outputs that an explanation predicts for new trials; None where it leaves the finite numbers."""
    if not trials:
        return []
    blank = [np.zeros((len(trial.time_s), len(dataset.outputs))) for trial in trials]
    problem = rival.problem.on(planned_data(dataset, trials, blank, 1))
    parameters = problem.parameters(rival.shared)
    return [problem.simulate(parameters, k, own) for k, own in enumerate(beginnings(rival, trials))]


def information(rival: Rival) -> FloatArray:
    """Return what data and prior say about parameters and effect sizes: J'J (p, p), initial states eliminated."""
    problem = rival.problem
    blocks = problem.jacobian(rival.z, central=False)
    slope = problem.priors.weight * problem.priors.scale / problem.priors.pull
    total = np.diag(slope**2)
    for own, shared in zip(blocks.own, blocks.shared, strict=True):
        left = _off(basis(own), shared)
        total = total + left.T @ left
    return np.asarray(total)


def rehearse(
    rivals: Rivals, dataset: Dataset, trials: Sequence[PlannedTrial], repeats: int
) -> list[Evidence]:
    """Return what old and new trials together would say, pair by pair, with every rival really fitted to the other."""
    found = []
    gains = {id(rivals.null): 0.0}
    for truth, other in rivals.pairs:
        if id(truth) not in gains:
            gains[id(truth)] = fitted_squares(truth, rivals.null, dataset, trials, repeats)
        null = other is rivals.null
        squares = gains[id(truth)] if null else fitted_squares(truth, other, dataset, trials, repeats)
        believed = slack(truth, rivals.null)
        found.append(Evidence(squares, gains[id(truth)], rivals.dispersion, price(truth, other), believed))
    return found


def fitted_squares(
    truth: Rival, other: Rival, dataset: Dataset, trials: Sequence[PlannedTrial], repeats: int
) -> float:
    """Return what `other` leaves, fitted to everything that `truth` predicts for old and new trials."""
    outputs = [one for one in predict(truth, dataset, trials) if one is not None]
    old = truth.problem.with_measured(truth.problem.simulated(truth.z)).data
    problem = other.problem.on(joined(old, planned_data(dataset, trials, outputs, repeats)))
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


def _with_null(rivals: Rivals) -> list[Rival]:
    return [*rivals.rivals, *([] if any(one is rivals.null for one in rivals.rivals) else [rivals.null])]


def _off(span: FloatArray, values: FloatArray) -> FloatArray:
    return np.asarray(values - span @ (span.T @ values))


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
