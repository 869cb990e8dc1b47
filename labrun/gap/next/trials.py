"""Trials that could be made, and the values that a condition could take beyond those that were measured."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import floor, log10

from labrun.arrays import FloatArray
from labrun.fit import Dataset, FitTrial
from labrun.gap import criteria


@dataclass(frozen=True)
class PlannedTrial:
    """One trial that the rig could make.

    Attributes
    ----------
    time_s : (n,)
        When outputs would be sampled.
    inputs : (n, k)
        What would drive the model, in its order.
    cost_s
        Rig time of all its repeats, moves, settling and resets included as far as they are known.
    like
        FitTrial of the data whose beginning it takes over, and a factor on it; None where the condition tells.
    reach
        How far it goes beyond what was measured, as a factor: the farther, the less any model is to be believed.
    begin_rad
        The angle at which the only joint begins; 0 where there are several.
    """

    label: str
    condition: Mapping[str, float | str]
    time_s: FloatArray
    inputs: FloatArray
    cost_s: float
    like: tuple[int, float] | None = None
    reach: float = 1.0
    begin_rad: float = 0.0


def planned_data(
    dataset: Dataset, trials: Sequence[PlannedTrial], outputs: Sequence[FloatArray], repeats: int
) -> Dataset:
    """Return new trials as averaged data, had they come out as `outputs` in every repeat."""
    made = tuple(
        FitTrial(
            trial.label,
            trial.condition,
            1,
            trial.time_s,
            trial.inputs,
            one,
            group=group,
            members=(one,) * repeats,
        )
        for group, (trial, one) in enumerate(zip(trials, outputs, strict=True))
    )
    return replace(dataset, trials=made, conditions=tuple(trial.label for trial in trials))


def joined(one: Dataset, other: Dataset) -> Dataset:
    """Return the trials of both, conditions of the second counted on."""
    shift = len(one.conditions)
    trials = (*one.trials, *(replace(trial, group=trial.group + shift) for trial in other.trials))
    return replace(one, trials=trials, conditions=(*one.conditions, *other.conditions))


_STEPS = 14
_WITHIN = (0.25, 0.5, 0.75)
_FURTHER = (1.25, 1.5, 2.0, 3.0)
_BY_HAND = (0.5, 1.5, 2.0)
_DIGITS = 3
_ANGLES = ("_deg", "_rad")


def beyond(measured: Sequence[float], allowed: Callable[[float], bool]) -> list[float]:
    """Return values inside, between and beyond the measured ones, and of the other sign, that are allowed.

    Parameters
    ----------
    allowed
        Whether the rig can do a value; asked on the way out, from the measured extremes.
    """
    found: list[float] = []
    ends = {max(measured), min(measured)} - {0.0}
    for end in ends:
        far = _farthest(end, allowed)
        found += [factor * end for factor in (*_WITHIN, *_FURTHER) if abs(factor * end) < abs(far)]
        found.append(far)
    if min(measured) * max(measured) >= 0.0:
        most = max((abs(one) for one in measured), default=0.0)
        sign = -1.0 if max(measured) > 0 else 1.0
        found += [sign * most, _farthest(sign * most, allowed)]
    return _new([one for one in map(rounded, found) if allowed(one)], measured)


def by_hand(name: str, measured: Sequence[float]) -> list[float]:
    """Return other values of what a person sets (a mass, a tilt), whose limits nobody states.

    What has been measured on both sides of zero, an angle (by its unit) and an orientation of +1 or -1 may change sign.
    """
    most = max(measured, key=abs)
    if most == 0.0:
        return []
    if all(abs(one) == 1.0 for one in measured):
        return _new([1.0, -1.0], measured)
    signed = [-most] if min(measured) < 0.0 < max(measured) or name.endswith(_ANGLES) else []
    return _new([rounded(one) for one in (*(factor * most for factor in _BY_HAND), *signed)], measured)


def reach(value: float, measured: Sequence[float]) -> float:
    """Return how far a value lies beyond the greatest measured one, as a factor of at least 1."""
    most = max(abs(one) for one in measured)
    return max(1.0, abs(value) / most) if most > 0 else 1.0


def rounded(value: float) -> float:
    """Return a value to three digits, towards zero: a limit is not overstepped by rounding."""
    if value == 0.0:
        return 0.0
    unit = 10.0 ** (floor(log10(abs(value))) - _DIGITS + 1)
    whole = int(abs(value) / unit + 1e-9)
    return float(f"{whole * unit if value > 0 else -whole * unit:.{_DIGITS}g}")


def _farthest(end: float, allowed: Callable[[float], bool]) -> float:
    """Return the farthest allowed value from `end` outwards."""
    if not allowed(end):
        return end
    low, high = 1.0, criteria.NO_LIMIT_NEAR
    if allowed(high * end):  # no limit speaks of it
        return criteria.FARTHEST_VALUE * end if allowed(criteria.FARTHEST_VALUE * end) else end
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if allowed(middle * end) else (low, middle)
    return low * end


def _new(values: Sequence[float], measured: Sequence[float]) -> list[float]:
    known = {rounded(one) for one in measured} | {0.0}
    return [one for one in dict.fromkeys(values) if one not in known]
