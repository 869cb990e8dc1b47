"""The form of a candidate: shapes that are fitted before anything is ruled out, and levels that it does without."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from labrun.arrays import FloatArray
from labrun.effects import EffectParameter
from labrun.fit import Problem, minimise
from labrun.gap import criteria
from labrun.gap.candidates import Candidate
from labrun.gap.noise_threshold import NoiseThreshold
from labrun.gap.screening import Base, Screened, around
from labrun.gap.steps import in_shorter_steps


def best_form(base: Base, screened: Screened, best: float, threshold: NoiseThreshold) -> Screened:
    """Return a candidate with its shape fitted, and without levels that nothing asks for, if it is worth that.

    Parameters
    ----------
    best
        Gain of the best candidate, or what has to be gained: of what is far behind it, no shape is looked at.
    """
    if screened.gain < criteria.SHAPED_BESIDE_BEST * max(best, threshold.gain):
        return screened
    usual = resolved(base, widened(base, screened))
    # a stiff stop has no better stiffness farther on as long as steps are too long for it
    usual = resolved(base, widened(base, usual))
    found = shaped(base, usual, threshold)
    found = usual if found is usual else resolved(base, found)
    found = without_needless_levels(base, found, threshold)
    return found if found.candidate is usual.candidate else replace(found, usual=usual)


def widened(base: Base, screened: Screened) -> Screened:
    """Return a candidate fitted in a wider range, where its size ended at the far end of what was searched.

    What is typical at a site comes from the model as it is: play in a joint that is rigid there goes far beyond its
    wind-up.
    """
    for _ in range(criteria.WIDENINGS):
        attached = screened.candidate.attached
        if attached is None:
            break
        sizes = iter(screened.sizes.tolist())
        parameters = tuple(
            one if one.held else _further(one, next(sizes)) for one in attached.effect.parameters
        )
        if parameters == attached.effect.parameters:
            break
        candidate = replace(
            screened.candidate,
            attached=replace(attached, effect=replace(attached.effect, parameters=parameters)),
        )
        problem = candidate.added_to(base.problem).in_steps_of(screened.problem)
        screened = replace(_ended(base, screened, problem, screened.z), candidate=candidate)
    return screened


def _further(one: EffectParameter, size: float) -> EffectParameter:
    if one.quantity == "ratio" or (one.neutral != 0.0 and one.quantity != "stiffness"):
        return one
    if one.lower < 0.0 and size <= (1.0 - criteria.NEAR_THE_END) * one.lower:
        return replace(one, lower=criteria.WIDER * one.lower)
    if size < (1.0 - criteria.NEAR_THE_END) * one.upper:
        return one
    return replace(one, upper=criteria.WIDER * one.upper)


def resolved(base: Base, screened: Screened) -> Screened:
    """Return a candidate fitted with steps of the integrator as short as its force asks for.

    The base's steps do for the base: friction that holds a joint still, or a stiff stop, wants shorter ones in the
    trials, and near the reversals, where it acts, and is fitted again with them.
    """
    while screened.candidate.attached is not None:
        problem = screened.problem
        finer = in_shorter_steps(problem, screened.z, criteria.STEPS_DO * screened.squares)
        if finer is problem:
            break
        # with derivatives in these steps: those in the longer ones led Stribeck's friction to the end of Coulomb's
        screened = _ended(base, screened, finer, screened.z)
    return screened


def _ended(base: Base, screened: Screened, problem: Problem, start: FloatArray) -> Screened:
    beside = around(base, screened.candidate)
    z = minimise(
        problem,
        start,
        tolerance=criteria.FIT_TOLERANCE,
        evaluations=criteria.FIT_EVALUATIONS,
        central=False,
        secant=True,
        beside=beside,
        renewals=criteria.FIT_RENEWALS,
    )
    squares = problem.squares(z)
    return replace(screened, problem=problem, z=z, squares=squares, gain=max(base.squares - squares, 0.0))


def shaped(base: Base, screened: Screened, threshold: NoiseThreshold) -> Screened:
    """Return the candidate with its shape fitted, if that explains clearly more; else as it was."""
    left = screened.squares - threshold.floor
    if screened.gain < threshold.gain or left < criteria.SHAPE_REMAINDER * screened.gain:
        return screened
    end = _shape_fitted(base, screened, threshold.floor)
    earned = threshold.log_likelihood(end.gain) - threshold.log_likelihood(screened.gain)
    needed = criteria.SHAPE_PRICE * (end.candidate.variables - screened.candidate.variables)
    least = min(criteria.SHAPE_EARNS * screened.gain, criteria.AS_GOOD * left)
    return end if earned >= needed and end.gain - screened.gain >= least else screened


def sharpened(base: Base, chosen: Screened, threshold: NoiseThreshold, noise_share: float) -> Screened:
    """Return a chosen cause with its shape fitted, if that explains clearly more of what it leaves.

    Beside it, what the usual sharpness or exponent leaves would be taken for a cause of its own.

    Parameters
    ----------
    chosen
        Fitted in units of what it leaves, where noise is not told by repeats.
    noise_share
        Part of the squares that it leaves which is noise.
    """
    usual = chosen if chosen.usual is None else chosen.usual
    attached = usual.candidate.attached
    if attached is None or not any(one.shape for one in attached.effect.parameters):
        return chosen
    in_these_units = replace(base, problem=base.problem.with_noise(chosen.problem.noise), brisk=False)
    end = _shape_fitted(in_these_units, chosen, noise_share * chosen.squares, usual.candidate)
    relative = np.isfinite(threshold.squares)
    of_what_is_left = replace(threshold, squares=chosen.squares) if relative else threshold
    earned = of_what_is_left.log_likelihood(max(chosen.squares - end.squares, 0.0))
    needed = criteria.SHAPE_PRICE * (end.candidate.variables - chosen.candidate.variables)
    return replace(end, usual=usual) if earned >= needed else chosen


def of_a_sign(screened: Screened) -> bool:
    """Tell whether a candidate's shapes are those of a sign: how sharply a friction turns."""
    attached = (screened.usual or screened).candidate.attached
    return attached is not None and any(
        one.shape and one.quantity == "rate" for one in attached.effect.parameters
    )


def _shape_fitted(base: Base, screened: Screened, floor: float, usual: Candidate | None = None) -> Screened:
    """Return the candidate with its shape among what is fitted; as it was if it has none.

    Parameters
    ----------
    floor
        Squared residual that is noise.
    usual
        The candidate with its shapes open, where one of them has been fitted already: the others are tried beside it.
    """
    size = base.problem.size
    shared, own = screened.z[:size], screened.problem.own_states(screened.z)
    beside = around(base, screened.candidate)
    best, known = screened, _fitted(screened.candidate)
    first = usual is None or known == _fitted(usual)
    sizes = {one.name: size for one, size in zip(known, screened.sizes.tolist(), strict=True)}
    for candidate, choices in _with_shape(screened.candidate if usual is None else usual):
        if _fitted(candidate) == known:
            continue
        problem = candidate.added_to(base.problem).in_steps_of(screened.problem)
        ends = [
            minimise(
                problem,
                np.concatenate([shared, start, own]),
                tolerance=criteria.ROUGH_TOLERANCE,
                evaluations=criteria.ROUGH_EVALUATIONS,
                central=False,
                secant=beside is not None,
                confirmed=beside is None,
                beside=beside,
            )
            for start in _starts(candidate, choices, sizes)
        ]
        end = replace(_ended(base, screened, problem, min(ends, key=problem.squares)), candidate=candidate)
        if first or end.squares - floor < criteria.OTHER_SHAPE_LEAVES * (best.squares - floor):
            best, first = end, False
    return best


def without_needless_levels(base: Base, screened: Screened, threshold: NoiseThreshold) -> Screened:
    """Return an effect of several levels without those that the data do not ask for: an end stop on one side only."""
    for name in _levels(screened.candidate):
        candidate = _out_of_reach(screened.candidate, name)
        problem = candidate.added_to(base.problem).in_steps_of(screened.problem)
        fitted = [one.name for one in _fitted(screened.candidate)]
        sizes = np.delete(screened.sizes, fitted.index(name))
        start = np.concatenate(
            [screened.z[: base.problem.size], sizes, screened.problem.own_states(screened.z)]
        )
        end = replace(_ended(base, screened, problem, start), candidate=candidate)
        lost = threshold.log_likelihood(screened.gain) - threshold.log_likelihood(end.gain)
        if lost < criteria.VARIABLE_PRICE:
            screened = end
    return screened


def _fitted(candidate: Candidate) -> list[EffectParameter]:
    attached = candidate.attached
    return [] if attached is None else [one for one in attached.effect.parameters if not one.held]


def _levels(candidate: Candidate) -> list[str]:
    """Return the fitted parameters that are out of reach without the effect, if there is more than one."""
    found = [one.name for one in _fitted(candidate) if one.neutral is not None and np.isinf(one.neutral)]
    return found if len(found) > 1 else []


def _out_of_reach(candidate: Candidate, name: str) -> Candidate:
    attached, scale = candidate.attached, candidate.scale
    if attached is None or scale is None:
        return candidate
    parameters, values = list(attached.effect.parameters), list(attached.values)
    place = [one.name for one in parameters].index(name)
    one = parameters[place]
    far = one.upper if one.neutral == np.inf else one.lower
    parameters[place], values[place] = replace(one, held=True), far * scale.of(one.quantity)
    effect = replace(attached.effect, parameters=tuple(parameters))
    return replace(candidate, attached=replace(attached, effect=effect, values=tuple(values)))


def _with_shape(candidate: Candidate) -> list[tuple[Candidate, list[tuple[float, ...]]]]:
    """Return the candidate with its shapes among what is fitted, and the starts of every variable; one for each choice.

    A shape that stands in for another one makes a candidate of its own. The starts of what is fitted anyway are left
    open (empty).
    """
    attached = candidate.attached
    if attached is None:
        return []
    shapes = [one for one in attached.effect.parameters if one.shape]
    found = []
    for choice in dict.fromkeys(one.instead_of for one in shapes):
        free = {one.name for one in shapes if one.instead_of in {"", choice} and one.name != choice}
        parameters = tuple(_settled(one, free) for one in attached.effect.parameters)
        choices = [one.starts[1:] if one.name in free else () for one in parameters if not one.held]
        effect = replace(attached.effect, parameters=parameters)
        found.append((replace(candidate, attached=replace(attached, effect=effect)), choices))
    return found


def _settled(one: EffectParameter, free: Collection[str]) -> EffectParameter:
    """Return a parameter that is fitted if it is among these, and is no open shape any more if it is not."""
    if not one.shape:
        return one
    return replace(one, held=False) if one.name in free else replace(one, starts=one.starts[:1])


def _starts(
    candidate: Candidate, choices: list[tuple[float, ...]], sizes: Mapping[str, float]
) -> list[tuple[float, ...]]:
    """Return the fitted sizes with every combination of the shapes' starts."""
    fitted = _fitted(candidate)
    return list(product(*(choice or (sizes[one.name],) for one, choice in zip(fitted, choices, strict=True))))
