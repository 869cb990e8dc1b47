"""When a search stops: iterations, trials, stagnation beyond the noise, step size."""

import math
from collections.abc import Sequence

from labrun.spec import StopRules

_BEYOND_NOISE = 2.0


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
            return f"{self.trials} trials; another generation of {planned_trials} would exceed {rules.trials}"
        return None

    def after_generation(self, costs: Sequence[float], standard_error: float, spread: float) -> str | None:
        """Count a generation; return why the descent is to end, None if it goes on.

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
