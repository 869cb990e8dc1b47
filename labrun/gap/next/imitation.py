"""How far parameters and initial states can imitate a change of the residuals, to first order."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.fit import Problem
from labrun.gap.nuisance import basis, off


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
