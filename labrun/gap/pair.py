"""Two units as one problem: what may differ between them, and what their trials say of a difference."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, Scale
from labrun.fit import Dataset, FitTrial, Problem

UNIT = "unit compared"
"""Key of a trial's condition that says which unit it is of."""
FIRST, SECOND, BOTH = "first", "second", ""
FEWEST_PIECES = 8
"""Pieces per unit that intervals rest on: trials, or where there are fewer, blocks of them."""


@dataclass(frozen=True, eq=False)
class UnitPair(Problem):
    """A problem of two units: some parameters differ in the second one, some effects act in one of them only.

    Attributes
    ----------
    places, slots
        Of what differs, its place among the parameters, and where its difference stands among them.
    ends
        The values it may take.
    only
        Of every effect, the unit that has it; "" where both do.
    """

    places: tuple[int, ...] = ()
    slots: tuple[int, ...] = ()
    ends: tuple[tuple[float, float], ...] = ()
    only: tuple[str, ...] = ()

    def differing(self, variable: int) -> Self:
        """Return the problem in which one more of the variables may differ in the second unit."""
        priors = self.priors
        place, scale = int(priors.free[variable]), priors.scale[variable]
        low, high = priors.lower[variable] * scale, priors.upper[variable] * scale
        if place < len(self.model.parameters):
            low, high = self.model.parameters[place].lower, self.model.parameters[place].upper
        released = replace(
            priors,
            values=np.append(priors.values, 0.0),
            free=np.append(priors.free, len(priors.values)),
            names=(*priors.names, f"difference of {priors.names[variable]}"),
            scale=np.append(priors.scale, scale),
            sigma=np.append(priors.sigma, np.inf),
            pull=np.append(priors.pull, 1e4 * scale),
            lower=np.append(priors.lower, -np.inf),
            upper=np.append(priors.upper, np.inf),
        )
        return replace(
            self,
            priors=released,
            places=(*self.places, place),
            slots=(*self.slots, len(priors.values)),
            ends=(*self.ends, (float(low), float(high))),
        )

    def with_effect_in(self, unit: str, attached: AttachedEffect, scale: Scale) -> Self:
        """Return the problem with an effect that one unit has."""
        return replace(self.with_effects([attached], [scale]), only=(*self.only, unit))

    def attached(self, parameters: FloatArray) -> tuple[AttachedEffect, ...]:
        """Return the effects with their sizes, as they are in the first unit."""
        return super().attached(np.delete(parameters, self.slots) if self.slots else parameters)

    def simulate(self, parameters: FloatArray, trial: int, own: FloatArray) -> FloatArray | None:
        """Return the outputs (n, m) of one trial of its unit; None where they are not finite."""
        unit, parameters = self.data.trials[trial].condition[UNIT], parameters.copy()
        if unit == SECOND:
            for place, slot, (low, high) in zip(self.places, self.slots, self.ends, strict=True):
                parameters[place] = min(max(parameters[place] + parameters[slot], low), high)
        free = np.setdiff1d(np.arange(len(parameters)), self.slots)[len(self.model.parameters) :]
        at = 0
        for number, one in enumerate(self.effects):
            has = self.only[number] if number < len(self.only) else ""
            for parameter in one.effect.parameters:
                if has not in ("", unit) and parameter.neutral is not None:
                    parameters[free[at]] = parameter.neutral
                at += 1
        return super().simulate(parameters, trial, own)


def both(first: Dataset, second: Dataset) -> Dataset:
    """Return the trials of both, each with its unit in its condition."""

    def of(data: Dataset, unit: str) -> list[FitTrial]:
        return [replace(one, condition={**one.condition, UNIT: unit}) for one in data.trials]

    return replace(first, trials=(*of(first, FIRST), *of(second, SECOND)))


@dataclass(frozen=True)
class EliminatedTrial:
    """A trial, or a block of one, at a fit: J'J and J'r of the shared variables, its own states eliminated."""

    unit: str
    fold: int
    information: FloatArray
    pull: FloatArray


def _pieces(problem: Problem, z: FloatArray) -> list[EliminatedTrial]:
    """Return the trials of both units, in blocks where there are fewer than eight; a fold is a trial, or its block."""
    jacobian = problem.jacobian(z)
    units = [one.condition[UNIT] for one in problem.data.trials]
    found: list[EliminatedTrial] = []
    for unit in (FIRST, SECOND):
        members = [index for index, one in enumerate(units) if one == unit]
        cuts = 1 if len(members) >= FEWEST_PIECES else -(-FEWEST_PIECES // len(members))
        for index in members:
            shared, own, residual = jacobian.shared[index], jacobian.own[index], jacobian.residual[index]
            if own.shape[1]:
                span = np.linalg.qr(own)[0]
                shared, residual = shared - span @ (span.T @ shared), residual - span @ (span.T @ residual)
            blocks = zip(np.array_split(shared, cuts), np.array_split(residual, cuts), strict=True)
            for block, (one, part) in enumerate(blocks):
                fold = index if len(members) > 1 else len(units) + len(found) + block
                found.append(EliminatedTrial(unit, fold, one.T @ one, one.T @ part))
    return found


def scatter(problem: Problem, z: FloatArray) -> tuple[FloatArray, int]:
    """Return standard deviations of the scaled variables from the scatter of trials, and their degrees of freedom.

    Few trials agree by chance: a deviation is not below that of white residuals of the size that is left.
    """
    pieces = _pieces(problem, z)
    prior = np.diag(problem.priors.slope**2)
    meat = prior.copy()  # what is stated is a measurement, too, and scatters as it says
    for unit in (FIRST, SECOND):
        pulls = np.array([one.pull for one in pieces if one.unit == unit])
        meat += pulls.T @ pulls * len(pulls) / (len(pulls) - 1)
    bread = _inverse(prior + sum(one.information for one in pieces))
    samples = sum(one.outputs.size for one in problem.data.trials) - problem.size
    dispersion = problem.squares(z) / max(samples, 1)
    variance = np.maximum(np.diag(bread @ meat @ bread), dispersion * np.diag(bread))
    return np.sqrt(np.maximum(variance, 1e-300)), max(len(pieces) - 2, 1)


def _inverse(matrix: FloatArray) -> FloatArray:
    scale = 1.0 / np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    around = np.outer(scale, scale)
    return np.asarray(np.linalg.pinv(matrix * around, rcond=1e-12, hermitian=True) * around)


def kept_unseen(problem: Problem, z: FloatArray, added: int) -> float:
    """Return the part of its gain that a difference keeps on trials it did not see, in the linear model at its fit.

    Each trial in turn is left to the others, once with the `added` last variables and once without them.
    """
    pieces = _pieces(problem, z)
    prior = np.diag(problem.priors.slope**2)
    kept = np.arange(problem.size - added)
    gone = -z[problem.size - added : problem.size]

    def step(chosen: Sequence[EliminatedTrial], *, without: bool) -> FloatArray:
        matrix = prior + sum((one.information for one in chosen), np.zeros_like(prior))
        pull = sum((one.pull for one in chosen), problem.priors.slope * problem.priors.residual(z))
        if not without:
            return np.asarray(-_inverse(matrix) @ pull)
        moved = np.concatenate([np.zeros(len(kept)), gone])
        moved[kept] = -_inverse(matrix[np.ix_(kept, kept)]) @ (pull + matrix @ moved)[kept]
        return moved

    def gain(chosen: Sequence[EliminatedTrial], tested: Sequence[EliminatedTrial]) -> float:
        steps = [step(chosen, without=without) for without in (True, False)]
        squares = [sum(2.0 * v @ one.pull + v @ one.information @ v for one in tested) for v in steps]
        return float(squares[0] - squares[1])

    folds = sorted({one.fold for one in pieces})
    unseen = sum(
        gain([one for one in pieces if one.fold != fold], [one for one in pieces if one.fold == fold])
        for fold in folds
    )
    return unseen / max(gain(pieces, pieces), 1e-300)
