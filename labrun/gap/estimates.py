"""Intervals: how sizes of causes, and the share of the gap they remove, would scatter if the trials were run again."""

from collections.abc import Mapping, Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import AttachedEffect, unit_of
from labrun.fit.dataset import Dataset
from labrun.fit.problem import Problem
from labrun.gap import criteria
from labrun.gap.bounds import least_levels
from labrun.gap.diagnosis import Estimate, Shrinkage
from labrun.gap.excess import Excess, group_means
from labrun.gap.noise import Noise
from labrun.gap.screening import Base, Screened
from labrun.models import Model

_RIDGE = 1e-10


def scatter(base: Base, draws: Sequence[Sequence[FloatArray]]) -> FloatArray:
    """Return how the scaled shared variables move with noise drawn from whole trials, (draws, size), linearly."""
    jacobian = base.absorption.jacobian
    size = base.problem.size
    prior = np.diag(base.problem.priors.slope)
    rows, noise = [], []
    for unit, (shared, own) in enumerate(zip(jacobian.shared, jacobian.own, strict=True)):
        stacked = np.column_stack([draw[unit] for draw in draws])
        span = np.linalg.qr(own)[0]  # without columns where no initial state is free
        rows.append(shared - span @ (span.T @ shared))
        noise.append(stacked - span @ (span.T @ stacked))
    matrix = np.concatenate([*rows, prior])
    right = np.concatenate([*noise, np.zeros((size, len(draws)))])
    norms = np.linalg.norm(matrix, axis=0)
    norms[norms == 0] = 1.0
    solution = np.linalg.lstsq(matrix / norms, right, rcond=_RIDGE)[0] / norms[:, None]
    moved: FloatArray = solution.T
    return moved


def values_of(
    problem: Problem, z: FloatArray, place: int, moved: FloatArray, model: Model, dataset: Dataset
) -> dict[str, Estimate]:
    """Return the sizes of the effect that stands at `place` among those of the problem, with 95 % intervals."""
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
        bounds = problem.priors.lower[variable] * scale, problem.priors.upper[variable] * scale
        found[parameter.name] = Estimate(
            float(value),
            float(max(value + min(low, 0.0), bounds[0])),
            float(min(value + max(high, 0.0), bounds[1])),
            units[parameter.name],
        )
        variable += 1
    return found


def parameter_value(
    problem: Problem, z: FloatArray, name: str, moved: FloatArray, model: Model
) -> dict[str, Estimate]:
    """Return the value of a parameter with its 95 % interval."""
    variable = problem.priors.names.index(name)
    scale = float(problem.priors.scale[variable])
    value = float(z[variable]) * scale
    low, high = np.percentile(moved[:, variable], [2.5, 97.5]) * scale
    unit = next(one.unit for one in model.parameters if one.name == name)
    return {name: Estimate(value, value + min(float(low), 0.0), value + max(float(high), 0.0), unit)}


def effect_units(attached: AttachedEffect, model: Model, dataset: Dataset) -> dict[str, str]:
    """Return the units of an effect's parameters at its site."""
    signal, coordinate = "1", "rad"
    if attached.effect.kind in ("input", "output"):
        signals = dataset.inputs if attached.effect.kind == "input" else dataset.outputs
        signal = next((one.unit for one in signals if one.name == attached.site), "1")
    else:
        site = model.place(attached.site, attached.effect.kind)
        # the unit of a coordinate is known where an output shows it
        coordinate = next((one.unit for one in dataset.outputs if one.name == site.coordinate), "rad")
    return {one.name: unit_of(one.quantity, coordinate, signal) for one in attached.effect.parameters}


def upper_bounds(
    screened: Screened, base: Base, dispersion: float, units: Mapping[str, str]
) -> dict[str, Estimate]:
    """Return how large an effect can be in these data (95 %), in SI: the largest size of what vanishes at zero.

    What cannot be negative, such as a friction, is bounded from zero up. What vanishes at infinity, such as the level
    of a saturation, is bounded by the least level; see `labrun.gap.bounds`.
    """
    candidate = screened.candidate
    if candidate.attached is None or candidate.scale is None:
        return {}
    size = base.problem.size
    fitted = [one for one in candidate.attached.effect.parameters if not one.held]
    found = {}
    norms = np.linalg.norm(screened.survey.directions, axis=0)
    for place, parameter in enumerate(fitted):
        if parameter.neutral != 0.0:
            continue
        per_unit = [
            norm / abs(z[size + place])
            for norm, z in zip(norms, screened.survey.starts, strict=True)
            if z[size + place] != 0 and norm > 0
        ]
        if not per_unit:
            continue
        room = abs(float(screened.z[size + place])) + criteria.NORMAL_95 * np.sqrt(dispersion) / float(
            np.median(per_unit)
        )
        scale = candidate.scale.of(parameter.quantity)
        bound = min(room, max(abs(parameter.lower), abs(parameter.upper))) * scale
        low, high = max(-bound, min(parameter.lower, 0.0) * scale), min(bound, parameter.upper * scale)
        found[parameter.name] = Estimate(bound, low, max(high, 0.0), units.get(parameter.name, "1"))
    return found | least_levels(screened, base, dispersion, units)


def shrinkage(
    units: Dataset,
    noise: Noise,
    before: Sequence[FloatArray],
    after: Sequence[FloatArray],
    rng: np.random.Generator,
) -> Shrinkage:
    """Return the share of the excess that is removed on withheld conditions, with a 90 % interval.

    It says what an experiment of a few new conditions would show: conditions are resampled whole, each with the noise
    that its mean has. Both ends may lie beyond 1, as a measured share may.
    """
    then, now = group_means(units, before), group_means(units, after)
    groups = len(then)
    sizes = np.array([len(mean) for mean, _ in then], dtype=float)
    shares = []
    for _ in range(criteria.RESAMPLES):
        drawn = group_means(units, noise.draw(units, rng))
        first, second = np.empty(groups), np.empty(groups)
        for group in range(groups):
            disturbance = drawn[group][0]
            floor = noise.mean_floor(group, then[group][1])
            first[group] = _shaken(then[group][0], disturbance, noise.sd, floor)
            second[group] = _shaken(now[group][0], disturbance, noise.sd, floor)
        chosen = rng.integers(0, groups, min(groups, criteria.NEW_CONDITIONS))
        total = float(sizes[chosen] @ first[chosen])
        if total > 0:
            shares.append(1.0 - float(sizes[chosen] @ second[chosen]) / total)
    whole = Excess(*_plain(units, noise, then)).total
    rest = Excess(*_plain(units, noise, now)).total
    value = 1.0 - rest / whole if whole > 0 else 0.0
    low, high = np.percentile(shares, [5.0, 95.0]) if shares else (value, value)
    # new conditions ask for more than those between the old ones: forms and parameters are extrapolated
    low = min(low, value) - criteria.FORM_ERROR - criteria.EXTRAPOLATED * max(1.0 - value, 0.0)
    high = max(high, value) + criteria.FORM_ERROR
    return Shrinkage(float(min(value, 1.0)), float(low), float(high))


def _shaken(mean: FloatArray, drawn: FloatArray, sd: FloatArray, floor: FloatArray) -> float:
    """Return the excess had the noise come out differently; its own square is taken off as twice the floor."""
    length = min(len(mean), len(drawn))
    again = np.mean(np.square((mean[:length] + drawn[:length]) / sd), axis=0) - 2.0 * floor
    return float(np.mean(again))


def _plain(
    units: Dataset, noise: Noise, groups: Sequence[tuple[FloatArray, int]]
) -> tuple[FloatArray, FloatArray]:
    present = [group for group in range(len(units.conditions)) if units.of_group(group)]
    values = [
        np.mean(np.square(mean / noise.sd), axis=0) - noise.mean_floor(group, count)
        for group, (mean, count) in zip(present, groups, strict=True)
    ]
    sizes = np.array([float(len(mean)) for mean, _ in groups])
    return np.array(values), sizes / sizes.sum()


def floor_of(
    units: Dataset, noise: Noise, rng: np.random.Generator, draws: int = criteria.FLOOR_DRAWS
) -> float:
    """Return the systematic residual that noise alone shows at most in 95 of 100 experiments."""
    found = []
    for _ in range(draws):
        means = group_means(units, noise.draw(units, rng))
        values, shares = _plain(units, noise, means)
        found.append(Excess(values, shares).gap)
    return float(np.percentile(found, criteria.FLOOR_PERCENTILE))
