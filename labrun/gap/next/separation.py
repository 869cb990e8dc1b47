"""How far trials would tell explanations apart, once each has been fitted to what the others predict (T-optimality).

Atkinson and Fedorov, Biometrika 62 (1975).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray, IntArray
from labrun.fit import Dataset, Problem
from labrun.gap import criteria, decide
from labrun.gap.diagnosis import Name
from labrun.gap.evidence import UnseenError
from labrun.gap.next.trials import PlannedTrial, planned_data
from labrun.gap.noise import Noise
from labrun.gap.nuisance import basis, off
from labrun.gap.pipeline import Search
from labrun.gap.selection import CauseSet

_NEXT_TRIALS = (2, 4)
"""Fewest and most trials that are proposed."""
_MOST_EXPLANATIONS = 6
"""Explanations that are held against one another."""
_PREDICTED_APART = 0.3
"""Difference between rivals, in units of what the outputs do, beyond which a fit may not find its way."""
_TOLD_APART = 1.5
"""Evidence, over what a diagnosis asks for, at which two explanations are expected to be told apart."""
_ENOUGH = 3.0
"""Evidence, over what a diagnosis asks for, at which no further trial is needed."""
_HOPELESS_EVIDENCE = 0.1
"""Evidence below which a pair has no part in the choice, and trials are not worth their time."""

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
        Number of variables of its causes.
    error
        What it leaves of recorded data that its fit has not seen.
    """

    name: str
    cause: Name | None
    problem: Problem
    z: FloatArray
    variables: int
    error: UnseenError

    @property
    def words(self) -> str:
        """Its name for people."""
        return self.name if self.cause is None else self.cause.words

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
        key = self.cause.effect, self.cause.site
        matching = [effect for effect in attached if (effect.effect.id, effect.site) == key]
        return dict(matching[-1].named_values) if matching else {}


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
    noise
        Of one trial.
    strata : (units,)
        Condition of each recorded unit of evidence.
    """

    rivals: tuple[Rival, ...]
    null: Rival
    doubt: bool
    why: str
    noise: Noise
    strata: IntArray

    @property
    def pairs(self) -> list[tuple[Rival, Rival]]:
        """Every two of them, each once as the truth and once as its rival."""
        return [(truth, other) for truth in self.rivals for other in self.rivals if truth is not other]

    def by_condition(self, values: FloatArray) -> FloatArray:
        """Return the mean of values (units,) over the units of each recorded condition."""
        return np.array([np.mean(values[self.strata == condition]) for condition in np.unique(self.strata)])


def rivals_of(search: Search) -> Rivals:
    """Return the explanations that a search leaves, fitted again closely.

    Where the diagnosis is in doubt these are the cause and what cannot be told from it. Where it is not, the cause is
    held against the runner-up, or against recalibration alone if there is none.
    """
    selection = search.selection
    reference = selection.reference
    null = Rival(NOTHING, None, reference.base.problem, reference.base.z, 0, reference.error)
    noise, strata = search.noise, search.units.strata
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
        names = " or ".join(rival.words for rival in rivals[1:])
        why = f"The data do not separate {rivals[0].words} from {names}."
        return Rivals(tuple(rivals), null, True, why, noise, strata)
    judged = [] if selection.first is None else selection.first.extended
    if not selection.chosen:
        best = [_named(entry.candidates[-1].name, entry) for entry in judged[:2]]
        why = "No cause was named: the best candidates are compared with recalibration alone."
        return Rivals((*best, null), null, False, why, noise, strata)
    cause = selection.chosen[-1]
    others = [entry for entry in judged if entry.names != last.names]
    if len(selection.chosen) == 1 and others:
        second = _named(others[0].candidates[-1].name, others[0])
        against = f"the runner-up, {second.words}"
    else:
        second, against = null, null.name
    first = _named(cause.name, last)
    why = f"The diagnosis is not in doubt: {first.words} is compared with {against}."
    return Rivals((first, second), null, False, why, noise, strata)


def _named(name: Name, model: CauseSet) -> Rival:
    variables = sum(candidate.variables for candidate in model.candidates)
    return Rival(str(name), name, model.base.problem, model.base.z, variables, model.error)


@dataclass(frozen=True)
class Change:
    """What something changes of the residuals of every trial, less what the initial states of the trial imitate.

    Attributes
    ----------
    parts : per trial (rows,)
    pull : (trials, p)
        Products with the derivatives by the parameters.
    squares : (trials,)
    """

    parts: tuple[FloatArray, ...]
    pull: FloatArray
    squares: FloatArray


class Imitation:
    """Parameters and initial states that move to imitate changes, as far as their bounds and what is known allow.

    Parameters
    ----------
    problem, z
        With the trials that could be made.
    known : (p, p)
        What prior and recorded data say of the parameters.
    """

    def __init__(self, problem: Problem, z: FloatArray, known: FloatArray, *, central: bool = True) -> None:
        self._spans, self._rows = _adapted(problem, z, central)
        self._information = np.array([rows.T @ rows for rows in self._rows])
        self._known = known
        shared = z[: problem.size]
        self._room = (
            np.minimum(problem.priors.lower - shared, 0.0),
            np.maximum(problem.priors.upper - shared, 0.0),
        )

    def change(self, residuals: Sequence[FloatArray]) -> Change:
        """Return a change of the residuals as it is compared here."""
        parts = tuple(off(span, part) for span, part in zip(self._spans, residuals, strict=True))
        pull = np.array([rows.T @ part for rows, part in zip(self._rows, parts, strict=True)])
        return Change(parts, pull, np.array([part @ part for part in parts]))

    def remaining(self, change: Change, chosen: Sequence[int]) -> float:
        """Return the sum of squares that the parameters cannot imitate: of the chosen trials, and what moving costs."""
        pull = change.pull[list(chosen)].sum(axis=0)
        moved = self.moved(change, chosen)
        squares = float(
            change.squares[list(chosen)].sum() - 2.0 * pull @ moved + moved @ self._total(chosen) @ moved
        )
        return max(squares, 0.0)

    def remainder(self, change: Change, chosen: Sequence[int], moved: FloatArray) -> list[FloatArray]:
        """Return what is left of each chosen trial, (rows,) each, once the parameters have moved."""
        return [change.parts[index] - self._rows[index] @ moved for index in chosen]

    def moved(self, change: Change, chosen: Sequence[int]) -> FloatArray:
        """Return how far the parameters move, (p,), to imitate a change of the chosen trials."""
        total, pull = self._total(chosen), change.pull[list(chosen)].sum(axis=0)
        moved, free = np.zeros(len(pull)), np.ones(len(pull), dtype=bool)
        while np.any(free):
            moved[free] = _solved(
                total[np.ix_(free, free)], pull[free] - total[np.ix_(free, ~free)] @ moved[~free]
            )
            inside = np.clip(moved, *self._room)
            beyond = free & (inside != moved)
            moved = inside
            if not np.any(beyond):
                break
            free &= ~beyond
        return moved

    def cosines(self, changes: Sequence[Change], chosen: Sequence[int]) -> FloatArray:
        """Return how alike changes are in the chosen trials once parameters adapt to each: |cosine|, (n, n)."""
        pull = np.array([change.pull[list(chosen)].sum(axis=0) for change in changes])
        whole = np.array([np.concatenate([change.parts[index] for index in chosen]) for change in changes])
        products = whole @ whole.T - pull @ _solved(self._total(chosen), pull.T)
        size = np.sqrt(np.maximum(np.diag(products), 1e-300))
        return np.asarray(np.abs(products) / np.outer(size, size))

    def _total(self, chosen: Sequence[int]) -> FloatArray:
        return np.asarray(self._known + self._information[list(chosen)].sum(axis=0))


def _solved(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Return the least-squares solution of normal equations, (p,) or (p, n), whatever the scales of the variables."""
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    solution = np.linalg.lstsq(matrix * np.outer(scale, scale), (right.T * scale).T, rcond=1e-12)[0]
    return np.asarray((solution.T * scale).T)


class Recorded:
    """What the recorded data say of a rival's parameters and effect sizes, its initial states eliminated.

    Attributes
    ----------
    information : (p, p)
        J'J of data and prior.
    by_condition : (conditions, p, p)
        J'J of the data of each condition, per sample and trial.
    """

    def __init__(self, problem: Problem, z: FloatArray) -> None:
        _, rows = _adapted(problem, z, central=False)
        products = [block.T @ block for block in rows]
        self.information = np.asarray(sum(products, np.diag(problem.priors.slope**2)))
        data, means = problem.data, []
        for group in range(len(data.conditions)):
            members = data.of_group(group)
            samples = sum(data.trials[index].outputs.size * data.trials[index].count for index in members)
            if members:
                means.append(np.sum([products[index] for index in members], axis=0) / samples)
        self.by_condition = np.array(means)

    def errors(self, moved: FloatArray) -> FloatArray:
        """Return the mean squares (conditions,) by which moved parameters miss the recorded data."""
        return np.asarray(np.einsum("i,cij,j->c", moved, self.by_condition, moved))


def _adapted(problem: Problem, z: FloatArray, central: bool) -> tuple[list[FloatArray], list[FloatArray]]:
    """Return, trial by trial, what initial states can do, and derivatives by the parameters without it."""
    jacobian = problem.jacobian(z, central=central)
    spans = [basis(own) for own in jacobian.own]
    return spans, [off(span, shared) for span, shared in zip(spans, jacobian.shared, strict=True)]


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
        return cheap if min(ratios(cheap)) >= _TOLD_APART else max(cheap, greedily(0.0), key=value)


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
