"""Which candidates of a search may run, and what those that may not cost."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from labrun.devices import Excess
from labrun.errors import RequestError
from labrun.search.constraints import constraints
from labrun.search.design import Condition
from labrun.spec import CmaEs, Penalty

FloatArray = NDArray[np.float64]

LimitExcesses = Callable[[Condition], Sequence[Excess]]

_PROBES = 1024


@dataclass(frozen=True, slots=True)
class Violations:
    """What a candidate breaks: how many constraints and limits, how far in all, and which."""

    number: int = 0
    size: float = 0.0
    texts: tuple[str, ...] = ()

    @property
    def feasible(self) -> bool:
        """Whether the candidate may run."""
        return self.number == 0


class Feasibility:
    """Checks candidates against the search's `where` and against every limit of the rig.

    Sizes are relative, so that they add up: a `where` by its largest violation found in the
    search space, a limit by its bound.

    Parameters
    ----------
    search
        Its variables and its `where`.
    limit_excesses
        Returns which limits of the rig a condition's motion would leave.
    """

    def __init__(self, search: CmaEs, limit_excesses: LimitExcesses) -> None:
        self._search = search
        self._limits = limit_excesses
        self._where = constraints(search.where, "cmaes")

    def of(self, conditions: Sequence[Condition]) -> list[Violations]:
        """Return what each condition violates; nothing is moved to find out."""
        if not conditions:
            return []
        columns = {
            name: np.array([c[name] for c in conditions], dtype=float) for name in self._search.variables
        }
        misses = [np.broadcast_to(item.violation(columns), (len(conditions),)) for item in self._where]
        return [
            self._of_one(condition, [float(miss[index]) for miss in misses])
            for index, condition in enumerate(conditions)
        ]

    def _of_one(self, condition: Condition, misses: Sequence[float]) -> Violations:
        sizes, texts = [], []
        for constraint, miss, scale in zip(self._where, misses, self._scales, strict=True):
            if miss > 0:
                sizes.append(miss / scale)
                texts.append(constraint.text)
        for size, text in self._limit_excesses(condition, already_out=bool(sizes)):
            sizes.append(size)
            texts.append(text)
        return Violations(len(sizes), float(sum(sizes)), tuple(texts))

    def _limit_excesses(self, condition: Condition, *, already_out: bool) -> list[tuple[float, str]]:
        try:
            excesses = self._limits(condition)
        except RequestError:
            # A gait need not be computable where a constraint forbids it, but must be where it may run.
            if already_out:
                return []
            raise
        return [(abs(e.value - e.bound) / (abs(e.bound) or 1.0), str(e)) for e in excesses]

    @cached_property
    def _scales(self) -> list[float]:
        columns = probes(self._search, _PROBES)
        return [float(np.max(item.violation(columns))) or 1.0 for item in self._where]


def probes(search: CmaEs, count: int) -> dict[str, FloatArray]:
    """Return `count` (a power of two) Sobol points that fill the search space evenly, a column a variable."""
    from scipy.stats import qmc

    variables = search.variables
    lower = [float(variable.start) for variable in variables.values()]
    upper = [float(variable.stop) for variable in variables.values()]
    points = qmc.scale(qmc.Sobol(len(variables), scramble=False).random(count), lower, upper)
    return {name: points[:, index] for index, name in enumerate(variables)}


def penalised(
    costs: Sequence[float | None],
    violations: Sequence[Violations],
    penalty: Penalty,
    *,
    seen: tuple[float, float] | None,
) -> list[float]:
    """Return the cost of every candidate of a generation.

    Parameters
    ----------
    costs
        Measured cost of each candidate (lower is better); None if it did not run or no trial was accepted.
    violations
        Of each candidate.
    penalty
        An infeasible candidate costs ``worst + spread * (per_violation * number + per_size * size)``, where worst and
        spread (largest less smallest) are those of the generation's measured costs: behind all that ran, and
        the further behind the more it violates. A feasible one without an accepted trial costs ``worst``.
    seen
        Smallest and largest cost of all earlier generations, used if nothing of this one was measured.
    """
    measured = [cost for cost in costs if cost is not None]
    low, high = (min(measured), max(measured)) if measured else (seen or (0.0, 0.0))
    spread = high - low or abs(high) or 1.0
    return [
        cost
        if cost is not None
        else high + spread * (penalty.per_violation * item.number + penalty.per_size * item.size)
        for cost, item in zip(costs, violations, strict=True)
    ]
