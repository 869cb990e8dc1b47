"""How far sizes in a fitted model may be off: noise, stated values, conditions that disagree, shapes that are held."""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, EffectParameter, unit_of
from labrun.fit import Dataset, Problem
from labrun.gap import criteria
from labrun.gap.diagnosis import Name, ResampledNumber
from labrun.gap.nuisance import off
from labrun.gap.screening import Base
from labrun.models import Model

_RIDGE = 1e-10


def scatter(base: Base, draws: Sequence[Sequence[FloatArray]]) -> FloatArray:
    """Return how the scaled shared variables move from one experiment to the next, (draws, size), linearly.

    Noise is drawn from whole trials; where conditions, each left out in turn, move a variable by more than that (a form
    that is not nature's asks for another size in each), it is drawn that much wider. What is stated of parameters is a
    measurement as well, as uncertain as its tolerance: it is drawn with the noise. So are shapes that are held, as far
    as the data leave them open.
    """
    linear = _Linear(base)
    count = len(draws)
    rng = np.random.default_rng(count)
    noise = linear.moved(
        [np.column_stack([draw[unit] for draw in draws]) for unit in range(len(base.residual))]
    )
    stated = rng.standard_normal((base.problem.size, count))
    stated[~np.isfinite(base.problem.priors.sigma)] = 0.0
    by_noise = np.std(noise, axis=1)
    wider = np.maximum(linear.disagreement() / np.where(by_noise > 0, by_noise, np.inf), 1.0)
    still = [np.zeros((len(part), count)) for part in base.residual]
    moved = noise * wider[:, None] + linear.moved(still, stated)
    for weights, moves in _shapes(base, linear):
        moved += moves[:, rng.choice(len(weights), count, p=weights)]
    return np.asarray(moved.T)


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
        return float(prior @ prior) + sum(float(one @ one) for one in changed)

    def disagreement(self) -> FloatArray:
        """Return the deviation of each variable that the conditions tell, each left out in turn (jackknife), (size,).

        As wide as Student's distribution asks for with so few. Zero where there are fewer than three.
        """
        groups = [one.group for one in self._problem.data.trials]
        present = sorted(set(groups))
        if len(present) < criteria.FEWEST_AGREEING:
            return np.zeros(self._problem.size)
        whole = self._matrix.T @ self._matrix
        moves = []
        for group in present:
            members = [unit for unit, one in enumerate(groups) if one == group]
            rows = np.concatenate([self._rows[unit] for unit in members]) / self._norms
            pull = rows.T @ np.concatenate([self._residual[unit] for unit in members])
            moves.append(np.linalg.lstsq(whole - rows.T @ rows, pull, rcond=_RIDGE)[0] / self._norms)
        away = np.array(moves) - np.mean(moves, axis=0)
        count = len(present)
        from scipy.stats import t

        wide = float(t.ppf(0.975, count - 1)) / criteria.NORMAL_95
        return np.asarray(wide * np.sqrt((count - 1.0) / count * np.sum(np.square(away), axis=0)))


def _shapes(base: Base, linear: _Linear) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield, for every shape that is held, how probable some values of it are and how sizes move with each.

    The first is that which is held.
    """
    problem = base.problem
    held = problem.effects[: len(problem.effects) - sum(one.attached is not None for one in base.added)]
    place = len(problem.model.parameters) + sum(len(one.values) for one in held)
    for candidate in base.added:
        if candidate.attached is None or candidate.scale is None:
            continue
        for parameter in candidate.attached.effect.parameters:
            if parameter.shape:
                scale = candidate.scale.of(parameter.quantity)
                yield _shape(base, linear, place, [one * scale for one in parameter.starts])
            place += 1


def _shape(base: Base, linear: _Linear, place: int, values: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    problem = base.problem
    stays = [np.zeros_like(part) for part in base.residual]
    moves = [np.zeros(problem.size)]
    squares = [linear.left(stays, moves[0])]
    for value in values:
        every = problem.priors.values.copy()
        every[place] = value
        other = replace(problem, priors=replace(problem.priors, values=every))
        residual = other.finite_residuals(base.z)
        if residual is None or value == problem.priors.values[place]:
            continue
        parts = [after - before for after, before in zip(residual, base.residual, strict=True)]
        moves.append(-linear.moved(parts))
        squares.append(linear.left(parts, moves[-1]))
    odds = np.exp(-0.5 * (np.array(squares) - min(squares)))
    return odds / odds.sum(), np.column_stack(moves)


def may_be_nothing(base: Base, moved: FloatArray) -> dict[Name, float]:
    """Return the added effects whose sizes may all be zero (95 %), with how many deviations the largest is from it.

    Not those with a level that is neutral at infinity: they are never fitted to nothing.

    Parameters
    ----------
    moved
        What `scatter` returns of the base.
    """
    found, variable = dict[Name, float](), base.problem.size - sum(one.variables for one in base.added)
    for candidate in base.added:
        effect = None if candidate.attached is None else candidate.attached.effect
        fitted = [one for one in effect.parameters if not one.held] if effect is not None else []
        places = [variable + place for place, one in enumerate(fitted) if one.neutral == 0.0]
        variable += candidate.variables
        if not places or any(one.neutral is not None and np.isinf(one.neutral) for one in fitted):
            continue
        low, high = (base.z[places] + end for end in np.percentile(moved[:, places], [2.5, 97.5], axis=0))
        if np.all((low <= 0.0) & (high >= 0.0)):
            spread = np.std(moved[:, places], axis=0)
            away = np.abs(base.z[places]) / np.where(spread > 0.0, spread, np.inf)
            found[candidate.name] = float(np.max(away))
    return found


def values_of(
    problem: Problem, z: FloatArray, place: int, moved: FloatArray, model: Model, dataset: Dataset
) -> dict[str, ResampledNumber]:
    """Return the sizes of the effect that stands at `place` among those of the problem, with 95 % intervals.

    Sizes and levels are those of the form as the library has it, which is not quite nature's.
    """
    attached = problem.attached(problem.parameters(z))[place]
    variable = problem.size - sum(
        not one.held for other in problem.effects[place:] for one in other.effect.parameters
    )
    found = {}
    units = effect_units(attached, model, dataset)
    for parameter, value in zip(attached.effect.parameters, attached.values, strict=True):
        if parameter.held:
            continue
        scale = float(problem.priors.scale[variable])
        low, high = np.percentile(moved[:, variable], [2.5, 97.5]) * scale
        form = criteria.NORMAL_95 * _form_error(parameter) * abs(value)
        low, high = -np.hypot(min(low, 0.0), form), np.hypot(max(high, 0.0), form)
        bounds = problem.priors.lower[variable] * scale, problem.priors.upper[variable] * scale
        found[parameter.name] = ResampledNumber(
            float(value),
            float(max(value + low, bounds[0])),
            float(min(value + high, bounds[1])),
            units[parameter.name],
        )
        variable += 1
    return found


def _form_error(parameter: EffectParameter) -> float:
    """Return the standard deviation that nature's form alone adds to a size or a level, as a part of it."""
    if parameter.neutral is None:
        return 0.0
    return criteria.FORM_OF_LEVELS if np.isinf(parameter.neutral) else criteria.FORM_OF_SIZES


def parameter_value(
    problem: Problem, z: FloatArray, name: str, moved: FloatArray, model: Model
) -> dict[str, ResampledNumber]:
    """Return the value of a parameter with its 95 % interval."""
    variable = problem.priors.names.index(name)
    scale = float(problem.priors.scale[variable])
    value = float(z[variable]) * scale
    low, high = np.percentile(moved[:, variable], [2.5, 97.5]) * scale
    unit = next(one.unit for one in model.parameters if one.name == name)
    return {name: ResampledNumber(value, value + min(float(low), 0.0), value + max(float(high), 0.0), unit)}


def effect_units(attached: AttachedEffect, model: Model, dataset: Dataset) -> dict[str, str]:
    """Return the units of an effect's parameters at its site."""
    signal, coordinate = "1", "rad"
    if attached.effect.kind in ("input", "output"):
        signals = dataset.inputs if attached.effect.kind == "input" else dataset.outputs
        signal = next((one.unit for one in signals if one.name == attached.site), "1")
    else:
        site = model.place(attached.site, attached.effect.kind)
        coordinate = model.coordinate_unit(site, dataset.signal_units)
    return {one.name: unit_of(one.quantity, coordinate, signal) for one in attached.effect.parameters}
