"""Trials that could be made, and the values that a condition could take beyond those that were measured."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import floor, log10
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import tomli_w

from labrun.arrays import FloatArray
from labrun.errors import RequestError
from labrun.fit import Dataset, FitTrial
from labrun.store import replace_durably, saving

NEXT_REPEATS = 3
"""Repeats of each proposed trial."""
_FARTHEST_VALUE = 4.0
_NO_LIMIT_NEAR = 20.0
"""How far beyond the greatest measured value, as a factor, where no limit is nearer than the second."""

T = TypeVar("T")


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
    dataset: Dataset,
    trials: Sequence[PlannedTrial],
    outputs: Sequence[FloatArray],
    repeats: int,
    after: int = 0,
) -> Dataset:
    """Return new trials as averaged data, had they come out as `outputs` in every repeat.

    Parameters
    ----------
    after
        Number of conditions that theirs are counted on from.
    """
    made = tuple(
        FitTrial(
            trial.label,
            trial.condition,
            1,
            trial.time_s,
            trial.inputs,
            output,
            group=group,
            members=(output,) * repeats,
        )
        for group, (trial, output) in enumerate(zip(trials, outputs, strict=True), start=after)
    )
    return replace(dataset, trials=made, conditions=tuple(trial.label for trial in trials))


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
    amplitudes: list[float] = []
    ends = {max(measured), min(measured)} - {0.0}
    for end in ends:
        far = _farthest(end, allowed)
        amplitudes += [factor * end for factor in (*_WITHIN, *_FURTHER) if abs(factor * end) < abs(far)]
        amplitudes.append(far)
    if min(measured) * max(measured) >= 0.0:
        most = max((abs(amplitude) for amplitude in measured), default=0.0)
        sign = -1.0 if max(measured) > 0 else 1.0
        amplitudes += [sign * most, _farthest(sign * most, allowed)]
    return _new([amplitude for amplitude in map(rounded, amplitudes) if allowed(amplitude)], measured)


def by_hand(name: str, measured: Sequence[float]) -> list[float]:
    """Return other values of what a person sets (a mass, a tilt), whose limits nobody states.

    What has been measured on both sides of zero, an angle (by its unit) and an orientation of +1 or -1 may change sign.
    """
    most = max(measured, key=abs)
    if most == 0.0:
        return []
    if all(abs(amplitude) == 1.0 for amplitude in measured):
        return _new([1.0, -1.0], measured)
    signed = [-most] if min(measured) < 0.0 < max(measured) or name.endswith(_ANGLES) else []
    return _new(
        [rounded(amplitude) for amplitude in (*(factor * most for factor in _BY_HAND), *signed)], measured
    )


def reach(value: float, measured: Sequence[float]) -> float:
    """Return how far a value lies beyond the greatest measured one, as a factor of at least 1."""
    most = max(abs(amplitude) for amplitude in measured)
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
    low, high = 1.0, _NO_LIMIT_NEAR
    if allowed(high * end):  # no limit speaks of it
        return _FARTHEST_VALUE * end if allowed(_FARTHEST_VALUE * end) else end
    for _ in range(_STEPS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if allowed(middle * end) else (low, middle)
    return low * end


def _new(values: Sequence[float], measured: Sequence[float]) -> list[float]:
    known = {rounded(amplitude) for amplitude in measured} | {0.0}
    return [fromkey for fromkey in dict.fromkeys(values) if fromkey not in known]


def evenly(items: Sequence[T], most: int) -> list[T]:
    """Return at most so many of the items, spread evenly over them."""
    places = np.unique(np.linspace(0, len(items) - 1, min(most, len(items))).round().astype(int))
    return [items[location] for location in places]


def free_place(folder: Path, stem: str, name: str = "") -> Path:
    """Return a path in a folder that is not taken: ``stem.toml``, ``stem-2.toml`` ...; or a folder's file `name`."""
    for number in range(1, 1000):
        numbered = stem if number == 1 else f"{stem}-{number}"
        path = folder / numbered / name if name else folder / f"{numbered}.toml"
        if not path.exists():
            return path
    raise RequestError(f"{folder} holds a thousand proposals already", hint="say where with --out")


def require_experiment_place(path: Path) -> None:
    """Raise RequestError unless an experiment file may be written there, and will be found by its name."""
    if path.suffix != ".toml":
        raise RequestError(
            f"{path} does not end in .toml: labrun would not find it as an experiment",
            hint=f"--out {path}.toml",
        )
    require_free(path)


def require_free(path: Path) -> None:
    """Raise RequestError if something is there."""
    if path.exists():
        raise RequestError(f"{path} is there already", hint="name another file, or move that one away")


def write_plan(path: Path, remarks: Sequence[str], tables: Mapping[str, Any]) -> None:
    """Write a TOML file with remarks at its head; StoreError where it cannot be written."""
    with saving(path.name, path.absolute().parent):
        path.parent.mkdir(parents=True, exist_ok=True)
        text = "".join(f"# {line}\n" for line in remarks) + tomli_w.dumps(tables)
        replace_durably(path, text.encode())
