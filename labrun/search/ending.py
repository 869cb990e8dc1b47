"""Stop rules of a search (converged, stagnated, budget spent), and the estimated remaining generations."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from labrun.experiment import StopRules

Ending = Literal["converged", "stagnated", "budget spent", "constant"]

_BEYOND_NOISE = 2.0
CONVERGED_BELOW = 0.02
"""Candidates that spread over less of every range count as one point, where the file does not say."""
_LEAST_GENERATIONS = 5
"""Fewer do not show whether the step size shrinks."""
_SURE = 2.0
"""A slope this many standard errors below zero is one."""


class StopWatch:
    """Counts generations and trials of a whole search, and watches each descent for progress.

    Iterations and trials end the search; stagnation and step size end a descent, after which a restart may follow.

    Attributes
    ----------
    generation
        Number of finished generations, over all restarts.
    trials
        Number of trials of candidates; the search adds to it.
    over
        Whether a rule has ended the whole search.
    range_of_costs
        Smallest and largest cost measured so far; None before the first.
    """

    def __init__(self, rules: StopRules) -> None:
        self._rules = rules
        self._reference = math.inf
        self._since = 0
        self.generation = 0
        self.trials = 0
        self.over = False
        self.range_of_costs: tuple[float, float] | None = None

    def restart(self) -> None:
        """Forget the progress of the descent before."""
        self._reference = math.inf
        self._since = 0

    def before_generation(self, planned_trials: int) -> str | None:
        """Return why no further generation may begin; None if one may. The first one always may."""
        rules = self._rules
        if self.generation >= rules.iterations:
            self.over = True
            return f"{self.generation} generations, as many as the file allows"
        if rules.trials is not None and self.generation and self.trials + planned_trials > rules.trials:
            self.over = True
            if self.trials > rules.trials:
                return (
                    f"{self.trials} trials, more than stop.trials = {rules.trials}: "
                    "a search measures one whole generation at least"
                )
            return f"{self.trials} trials; another generation of {planned_trials} would exceed {rules.trials}"
        return None

    def after_generation(self, costs: Sequence[float], standard_error: float, spread: float) -> str | None:
        """Count a generation; return the reason to stop, or None.

        Parameters
        ----------
        costs
            Measured costs (lower is better) of the generation.
        standard_error
            Of one candidate's cost.
        spread
            Largest standard deviation of the search distribution, as a share of the variable's range.

        Notes
        -----
        Progress is a mean of the better half of the costs that falls below the best such mean so far by more
        than twice its standard error: a slow gain adds up against the reference, a lucky generation is none.
        """
        self.generation += 1
        rules = self._rules
        if costs:
            self._note_progress(costs, standard_error)
        else:
            self._since += 1
        if rules.stagnation is not None and self._since >= rules.stagnation:
            return f"no progress beyond the noise in {self._since} generations"
        if rules.step_size_below is not None and spread < rules.step_size_below:
            return f"step size {spread:.2g} of the ranges is below {rules.step_size_below:g}"
        return None

    def _note_progress(self, costs: Sequence[float], standard_error: float) -> None:
        low, high = self.range_of_costs or (math.inf, -math.inf)
        self.range_of_costs = (min(low, *costs), max(high, *costs))
        better = sorted(costs)[: max(1, len(costs) // 2)]
        centre = sum(better) / len(better)
        if centre < self._reference - _BEYOND_NOISE * standard_error / math.sqrt(len(better)):
            self._reference = centre
            self._since = 0
        else:
            self._since += 1


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict of a search.

    Attributes
    ----------
    ending
        "converged": candidates no longer differ; "stagnated": no progress beyond the noise while they still do; "budget
        spent": generations or trials ran out before either; "constant": every candidate gave the same value.
    reason
        The rule that ended it.
    spread, goal
        Largest standard deviation of the candidates at the end, as a share of a variable's range, and where it counts
        as converged.
    generations, trials
        That it took.
    further_generations, further_trials
        What it would still take to `goal` at the pace so far; None if it has converged, or does not approach it.
    level
        Of a search for each level of a factor: which one.
    """

    ending: Ending
    reason: str
    spread: float
    goal: float
    generations: int
    trials: int
    further_generations: int | None = None
    further_trials: int | None = None
    level: Mapping[str, float | str] | None = None

    @property
    def text(self) -> str:
        """What a person reads."""
        size = f"{100 * self.spread:.2g} % of a range"
        if self.ending == "converged":
            return f"converged: {self.reason}; candidates spread over {size}"
        if self.ending == "constant":
            return (
                f"constant: all {self.trials} trials gave the same value, so the objective does not depend on the "
                "parameters; check its channel, and that the gait uses them"
            )
        if self.ending == "stagnated":
            rest = f"candidates still spread over {size}: what is left to gain is hidden by the noise"
            return f"stagnated: {self.reason}; {rest}; more repeats would show it, or a larger population"
        rest = (
            f"not converged: candidates still spread over {size}, {100 * self.goal:.2g} % counts as converged"
        )
        if self.further_generations is None:
            open_end = "they do not draw together yet, so nobody can say how much more it takes"
            return f"budget spent: {self.reason}; {rest}; {open_end}"
        one_or_more = "generation" if self.further_generations == 1 else "generations"
        some = f"about {self.further_generations} more {one_or_more} ({self.further_trials} trials)"
        return f"budget spent: {self.reason}; {rest}; at the pace so far that takes {some}"

    def to_record(self) -> dict[str, Any]:
        """Return everything, JSON-ready."""
        return {**asdict(self), "text": self.text}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Verdict":
        """Take back what `to_record` gave."""
        return cls(**{name: record[name] for name in cls.__slots__})


def judge(
    reason: str,
    spreads: Sequence[float],
    *,
    budget_spent: bool,
    is_constant: bool,
    goal: float | None,
    trials: int,
    trials_each: int,
    generations: int,
    level: Mapping[str, float | str] | None = None,
) -> Verdict:
    """Return the verdict of a search.

    Parameters
    ----------
    reason
        Why its last descent ended.
    spreads
        Largest standard deviation of the candidates after each generation of that descent, as a share of the range.
    budget_spent
        Whether generations or trials ran out.
    is_constant
        Whether every trial gave the same value.
    goal
        Spread below which the file wants it to end; `CONVERGED_BELOW` if None.
    trials, trials_each, generations
        Trials so far, of one more generation, and generations so far.

    Notes
    -----
    What it would still take follows from a straight line through the logarithm of the later half of `spreads`: near an
    optimum CMA-ES converges log-linearly (Hansen 2016, arXiv:1604.00772). It is given only where the slope is negative
    by more than twice its standard error.
    """
    limit = CONVERGED_BELOW if goal is None else goal
    spread = spreads[-1] if spreads else math.inf
    if is_constant:
        return Verdict("constant", reason, spread, limit, generations, trials, level=level)
    if spread < limit:
        return Verdict("converged", reason, spread, limit, generations, trials, level=level)
    if not budget_spent:
        return Verdict("stagnated", reason, spread, limit, generations, trials, level=level)
    further = _further(spreads, limit)
    return Verdict(
        "budget spent",
        reason,
        spread,
        limit,
        generations,
        trials,
        further,
        None if further is None else further * trials_each,
        level,
    )


def _further(spreads: Sequence[float], goal: float) -> int | None:
    later = np.log(np.asarray(spreads[len(spreads) // 2 :], dtype=float))
    if len(later) < _LEAST_GENERATIONS:
        return None
    number = np.arange(len(later)) - (len(later) - 1) / 2
    slope = float(number @ later) / float(number @ number)
    rest = later - later.mean() - slope * number
    error = math.sqrt(float(rest @ rest) / (len(later) - 2) / float(number @ number))
    if slope + _SURE * error >= 0.0:
        return None
    return max(1, math.ceil((math.log(goal) - float(later[-1])) / slope))
