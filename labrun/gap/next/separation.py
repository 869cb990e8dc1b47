"""How far trials would tell rivals apart, once each has been fitted to what the others predict (T-optimality)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit.dataset import Dataset
from labrun.fit.levenberg_marquardt import minimise
from labrun.gap.next.rivals import Rival, Rivals
from labrun.gap.next.trials import PlannedTrial, beginnings, joined, planned_data
from labrun.gap.nuisance import basis

_CLEAR = 3.0
"""Log likelihood between two explanations at which the weaker one's weight falls below a twentieth."""
_EACH_VARIABLE = 3.0
"""What a further variable must earn, as in the rating of candidates."""
_FORM_SLACK = (0.006, 0.02)
"""Part of a gain that the idealised form of a true effect may lack, as a diagnosis has it."""
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
    slack: float = _FORM_SLACK[1]

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
        return (self.log_likelihood - self.price) / (_CLEAR * softness)


def slack(truth: Rival, null: Rival) -> float:
    """Return how far the form of an explanation is to be believed: as much as it leaves of what it is to explain."""
    gain = null.squares - truth.squares
    rows = sum(part.size for part in truth.problem.residuals(truth.z))
    left = max(truth.squares - rows, 0.0) / gain if gain > 0 else 1.0
    return float(np.clip(left, *_FORM_SLACK))


def price(truth: Rival, other: Rival) -> float:
    """Return what `truth` must earn for its further variables."""
    return _EACH_VARIABLE * (max(truth.variables, 1) - max(other.variables, 1))


_APART = 0.3
"""Difference between rivals, in units of what the outputs do, beyond which a fit may not find its way."""


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
        return max(1.0, apart / _APART) ** 2 * self.trials[index].reach ** 2

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


def _with_null(rivals: Rivals) -> list[Rival]:
    return [*rivals.rivals, *([] if any(one is rivals.null for one in rivals.rivals) else [rivals.null])]


def _off(span: FloatArray, values: FloatArray) -> FloatArray:
    return np.asarray(values - span @ (span.T @ values))
