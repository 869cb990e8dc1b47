"""What parameters and initial states imitate in any choice of trials, to first order; and how trials are chosen."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Problem
from labrun.gap.nuisance import basis, off

_NEXT_TRIALS = (2, 4)
"""Fewest and most trials that are proposed ."""


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
    """Parameters and initial states that move to imitate changes, as far as what is known of them allows.

    What they cannot imitate tells two explanations apart (Atkinson and Fedorov, Biometrika 62, 1975).

    Parameters
    ----------
    problem, z
        With the trials that could be made.
    known : (p, p)
        What prior and data that are there already say of the parameters.
    """

    def __init__(self, problem: Problem, z: FloatArray, known: FloatArray, *, central: bool = True) -> None:
        self._spans, self._rows = _adapted(problem, z, central)
        self._information = np.array([rows.T @ rows for rows in self._rows])
        self._known = known

    def change(self, residuals: Sequence[FloatArray]) -> Change:
        """Return a change of the residuals as it is compared here."""
        parts = tuple(off(span, part) for span, part in zip(self._spans, residuals, strict=True))
        pull = np.array([rows.T @ part for rows, part in zip(self._rows, parts, strict=True)])
        return Change(parts, pull, np.array([part @ part for part in parts]))

    def left(self, change: Change, chosen: Sequence[int]) -> float:
        """Return the sum of squares that the parameters cannot imitate in the chosen trials."""
        pull = change.pull[list(chosen)].sum(axis=0)
        whole = float(change.squares[list(chosen)].sum())
        return max(whole - float(pull @ self._moved(pull, chosen)), 0.0)

    def cosines(self, changes: Sequence[Change], chosen: Sequence[int]) -> FloatArray:
        """Return how alike changes are in the chosen trials once parameters adapt to each: |cosine|, (n, n)."""
        pull = np.array([one.pull[list(chosen)].sum(axis=0) for one in changes])
        whole = np.array([np.concatenate([one.parts[index] for index in chosen]) for one in changes])
        products = whole @ whole.T - pull @ self._moved(pull.T, chosen)
        size = np.sqrt(np.maximum(np.diag(products), 1e-300))
        return np.asarray(np.abs(products) / np.outer(size, size))

    def _moved(self, pull: FloatArray, chosen: Sequence[int]) -> FloatArray:
        """Return where the parameters go that are pulled, (p,) or (p, n)."""
        total = self._known + self._information[list(chosen)].sum(axis=0)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(total), 1e-300))
        moved = np.linalg.lstsq(total * np.outer(scale, scale), (pull.T * scale).T, rcond=1e-12)[0]
        return np.asarray((moved.T * scale).T)


def information(problem: Problem, z: FloatArray) -> FloatArray:
    """Return what data and prior say about parameters and effect sizes: J'J (p, p), initial states eliminated."""
    _, rows = _adapted(problem, z, central=False)
    return np.asarray(sum((one.T @ one for one in rows), np.diag(problem.priors.slope**2)))


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
