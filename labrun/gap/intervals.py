"""How far sizes in a fitted model may be off: noise, stated values, conditions that disagree, shapes that are held."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, EffectParameter, unit_of
from labrun.fit import Dataset, Problem
from labrun.gap import numerics
from labrun.gap.diagnosis import ResampledNumber
from labrun.gap.evidence import Units
from labrun.gap.noise import Noise
from labrun.gap.nuisance import off
from labrun.gap.screening import Base
from labrun.models import Model

_FORM_OF_SIZES = 0.04
"""Standard deviation that no size of an effect falls below, as a part of it."""
_FORM_OF_LEVELS = 0.005
"""The same of a level, which hardly depends on how its corner is rounded."""

_RIDGE = 1e-10
"""Precision, in units of the largest, that keeps directions which nothing shows from growing without bound."""


def scatter(base: Base, noise: Noise, units: Units, rng: np.random.Generator) -> FloatArray:
    """Return how the scaled shared variables move from one experiment to the next, (draws, size), linearly.

    With known noise it is redrawn from whole trials; where units of evidence, each left out in turn, move a variable by
    more than that (an idealised form asks for another size in each), it is drawn that much wider. Without, these moves
    alone tell (jackknife). What is stated of parameters is a measurement as well, as uncertain as its tolerance: it is
    drawn with the noise. So are shapes that are held, as far as the data leave them open.
    """
    linear, count = _Linear(base), numerics.INTERVAL_DRAWS
    away = linear.moves_without_each(units)
    if noise.known:
        moved = linear.moved(_noise_draws(base.problem, noise, count, rng))
        by_noise, by_units = np.std(moved, axis=1), np.sqrt(np.sum(np.square(away), axis=0))
        moved *= np.maximum(by_units / np.where(by_noise > 0, by_noise, np.inf), 1.0)[:, None]
    else:
        moved = away.T @ rng.standard_normal((len(away), count))
    stated = rng.standard_normal((base.problem.size, count))
    stated[~np.isfinite(base.problem.priors.sigma)] = 0.0
    still = [np.zeros((len(part), count)) for part in base.residual]
    moved = moved + linear.moved(still, stated)
    for weights, moves in _shapes(base, linear):
        moved += moves[:, rng.choice(len(weights), count, p=weights)]
    return np.asarray(moved.T)


def _noise_draws(problem: Problem, noise: Noise, count: int, rng: np.random.Generator) -> list[FloatArray]:
    """Return whitened noise of the mean of every trial, as the residuals of `problem` see it, draws in columns."""
    behind = np.zeros(problem.behind)  # no noise is drawn for what is known of the trial's own variables
    draws = [noise.draw(problem.data, rng) for _ in range(count)]
    return [
        np.column_stack(
            [
                np.concatenate([problem.whiten(draw[index] * problem.noise.weights, index).ravel(), behind])
                for draw in draws
            ]
        )
        for index in range(len(problem.data.trials))
    ]


class _Linear:
    """A fit, linearised where it ended; each trial's own variables adapt."""

    def __init__(self, base: Base) -> None:
        jacobian, self._problem, self._at = base.nuisance.jacobian, base.problem, base.z
        self._spans = [np.linalg.qr(own)[0] for own in jacobian.own]
        self._rows = self._adapted(jacobian.shared)
        self._prior = np.diag(base.problem.priors.slope)
        matrix = np.concatenate([*self._rows, self._prior])
        self._norms = np.linalg.norm(matrix, axis=0)
        self._norms[self._norms == 0] = 1.0
        self._matrix = matrix / self._norms
        self._residual = self._adapted(base.residual)

    def _adapted(self, parts: Sequence[FloatArray]) -> list[FloatArray]:
        return [off(span, part) for span, part in zip(self._spans, parts, strict=True)]

    def moved(self, parts: Sequence[FloatArray], prior: FloatArray | None = None) -> FloatArray:
        """Return by how much residuals (one array per unit, draws in columns) and those of the prior move variables."""
        rows = self._adapted(parts)
        behind = np.zeros((len(self._prior), *rows[0].shape[1:])) if prior is None else prior
        solution = np.linalg.lstsq(self._matrix, np.concatenate([*rows, behind]), rcond=_RIDGE)[0]
        return np.asarray((solution.T / self._norms).T)

    def left(self, parts: Sequence[FloatArray], move: FloatArray) -> float:
        """Return the sum of squares, prior included, once residuals changed by `parts` and variables moved."""
        prior = self._problem.priors.residual(self._at) + self._prior @ move
        rows = zip(self._residual, self._rows, self._adapted(parts), strict=True)
        changed = [part + row @ move + more for part, row, more in rows]
        return float(prior @ prior) + sum(float(vector @ vector) for vector in changed)

    def moves_without_each(self, units: Units) -> FloatArray:
        """Return the scaled deviations of each variable with each unit of evidence left out (jackknife), (units, size).

        The sum of their squares is the variance of a variable, as wide as Student's distribution asks for with so few.
        None where there are fewer than two units.
        """
        data = self._problem.data
        present = sorted({trial.group for trial in data.trials})
        whole = self._matrix.T @ self._matrix
        moves = []
        for group, blocks in zip(present, units.blocks, strict=True):
            members = [index for index, trial in enumerate(data.trials) if trial.group == group]
            for block in range(blocks):
                rows, residual = [], []
                for index in members:
                    samples = len(data.trials[index].outputs)
                    seen = np.repeat(np.arange(samples) * blocks // samples == block, len(data.outputs))
                    seen = np.concatenate(
                        [seen, np.zeros(len(self._residual[index]) - len(seen), dtype=bool)]
                    )
                    rows.append(self._rows[index][seen])
                    residual.append(self._residual[index][seen])
                inside = np.concatenate(rows) / self._norms
                pull = inside.T @ np.concatenate(residual)
                moves.append(np.linalg.lstsq(whole - inside.T @ inside, pull, rcond=_RIDGE)[0] / self._norms)
        count = len(moves)
        if count < 2:
            return np.zeros((0, self._problem.size))
        from scipy.stats import t

        wide = float(t.ppf(0.975, count - 1)) / numerics.NORMAL_95
        away = np.array(moves) - np.mean(moves, axis=0)
        return np.asarray(wide * np.sqrt((count - 1.0) / count) * away)


def _shapes(base: Base, linear: _Linear) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield, for every shape that is held, how probable some values of it are and how sizes move with each.

    The first is that which is held.
    """
    problem = base.problem
    held = problem.effects[
        : len(problem.effects) - sum(candidate.attached is not None for candidate in base.added)
    ]
    position = len(problem.model.parameters) + sum(len(effect.values) for effect in held)
    for candidate in base.added:
        if candidate.attached is None or candidate.scale is None:
            continue
        for parameter in candidate.attached.effect.parameters:
            if parameter.shape:
                scale = candidate.scale.of(parameter.quantity)
                yield _shape(base, linear, position, [start * scale for start in parameter.starts])
            position += 1


def _shape(
    base: Base, linear: _Linear, position: int, values: Sequence[float]
) -> tuple[FloatArray, FloatArray]:
    problem = base.problem
    stays = [np.zeros_like(part) for part in base.residual]
    moves = [np.zeros(problem.size)]
    squares = [linear.left(stays, moves[0])]
    for value in values:
        every = problem.priors.values.copy()
        every[position] = value
        other = replace(problem, priors=replace(problem.priors, values=every))
        residual = other.finite_residuals(base.z)
        if residual is None or value == problem.priors.values[position]:
            continue
        parts = [after - before for after, before in zip(residual, base.residual, strict=True)]
        moves.append(-linear.moved(parts))
        squares.append(linear.left(parts, moves[-1]))
    odds = np.exp(-0.5 * (np.array(squares) - min(squares)))
    return odds / odds.sum(), np.column_stack(moves)


def values_of(
    problem: Problem, z: FloatArray, position: int, moved: FloatArray, model: Model, dataset: Dataset
) -> dict[str, ResampledNumber]:
    """Return the sizes of the effect that stands at `place` among those of the problem, with 95 % intervals.

    Sizes and levels are those of the form as the library has it, which is not quite nature's.
    """
    attached = problem.attached(problem.parameters(z))[position]
    variable = problem.size - sum(
        not parameter.held for other in problem.effects[position:] for parameter in other.effect.parameters
    )
    values = {}
    units = effect_units(attached, model, dataset)
    for parameter, value in zip(attached.effect.parameters, attached.values, strict=True):
        if parameter.held:
            continue
        scale = float(problem.priors.scale[variable])
        low, high = np.percentile(moved[:, variable], [2.5, 97.5]) * scale
        form = numerics.NORMAL_95 * _form_error(parameter) * abs(value)
        low, high = -np.hypot(min(low, 0.0), form), np.hypot(max(high, 0.0), form)
        bounds = problem.priors.lower[variable] * scale, problem.priors.upper[variable] * scale
        values[parameter.name] = ResampledNumber(
            float(value),
            float(max(value + low, bounds[0])),
            float(min(value + high, bounds[1])),
            units[parameter.name],
        )
        variable += 1
    return values


def reference_values(
    problem: Problem, z: FloatArray, index: int, model: Model, dataset: Dataset
) -> dict[str, tuple[float, str]]:
    """Return what the sizes of the effect at `index` refer to, with units: its held parameters but for zeros.

    A shape that is held at zero is that of another form, which is not used.
    """
    attached = problem.attached(problem.parameters(z))[index]
    units = effect_units(attached, model, dataset)
    pairs = zip(attached.effect.parameters, attached.values, strict=True)
    return {
        parameter.name: (float(value), units[parameter.name])
        for parameter, value in pairs
        if parameter.held and value != 0.0
    }


def _form_error(parameter: EffectParameter) -> float:
    """Return the standard deviation that nature's form alone adds to a size or a level, as a part of it."""
    if parameter.neutral is None:
        return 0.0
    return _FORM_OF_LEVELS if np.isinf(parameter.neutral) else _FORM_OF_SIZES


def parameter_value(
    problem: Problem, z: FloatArray, name: str, moved: FloatArray, model: Model
) -> dict[str, ResampledNumber]:
    """Return the value of a parameter with its 95 % interval."""
    variable = problem.priors.names.index(name)
    scale = float(problem.priors.scale[variable])
    value = float(z[variable]) * scale
    low, high = np.percentile(moved[:, variable], [2.5, 97.5]) * scale
    unit = next(parameter.unit for parameter in model.parameters if parameter.name == name)
    return {name: ResampledNumber(value, value + min(float(low), 0.0), value + max(float(high), 0.0), unit)}


def effect_units(attached: AttachedEffect, model: Model, dataset: Dataset) -> dict[str, str]:
    """Return the units of an effect's parameters at its site."""
    signal, coordinate = "1", "rad"
    if attached.effect.kind in ("input", "output"):
        signals = dataset.inputs if attached.effect.kind == "input" else dataset.outputs
        signal = next((s.unit for s in signals if s.name == attached.site), "1")
    else:
        site = model.site_named(attached.site, attached.effect.kind)
        coordinate = model.coordinate_unit(site, dataset.signal_units)
    return {
        parameter.name: unit_of(parameter.quantity, coordinate, signal)
        for parameter in attached.effect.parameters
    }
