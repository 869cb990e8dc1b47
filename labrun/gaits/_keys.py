"""What the built-in gaits share: checked keys, values of expressions, and the times of the points."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict

from labrun.devices import FloatArray, Trajectory
from labrun.errors import SpecError
from labrun.spec.experiment import Expression, Value
from labrun.toml import dotted, evaluate, names_in, resolve, validate


class Keys(BaseModel):
    """Keys of a joint or of a gait: numbers or expressions, none unknown."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class NoSettings(Keys):
    """A gait without keys of its own."""


def check(
    gait: str, model: type[Keys], joints: Mapping[str, Mapping[str, Expression]], settings: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the keys of each joint, validated.

    Raises
    ------
    SpecError
        All keys that do not hold; expressions that cannot be read.
    """
    problems = validate(NoSettings, dict(settings), ("gait",))[1]
    checked: dict[str, Any] = {}
    for joint, keys in joints.items():
        checked[joint], found = validate(model, dict(keys), ("gait", "joints", joint))
        problems += found
        for expression in keys.values():
            names_in(expression)
    if problems:
        raise SpecError("\n".join(f'gait "{gait}": {dotted(item.path)}: {item.message}' for item in problems))
    return checked


class Scope:
    """The names an expression of a gait may use: the condition's values, and `let`."""

    def __init__(
        self, let: Mapping[str, Expression], condition: Mapping[str, Value], **own: FloatArray
    ) -> None:
        self._names = resolve(let, {**condition, **own})

    def number(self, expression: Expression, what: str) -> float:
        """Return the value of an expression; an error names `what` it is for."""
        value = evaluate(expression, self._names)
        if isinstance(value, np.ndarray):
            raise SpecError(f"{what} = {expression!r} changes with time, where one number is needed")
        return value

    def series(self, expression: Expression, count: int) -> FloatArray:
        """Return the value of an expression at every point, shape (count,)."""
        return np.broadcast_to(np.asarray(evaluate(expression, self._names), dtype=float), (count,))


def points(duration_s: float, rate_hz: float) -> FloatArray:
    """Return times from 0 to `duration_s`, evenly spaced, at no less than `rate_hz`."""
    if not (duration_s > 0 and math.isfinite(duration_s)):
        raise SpecError(f"a motion of {duration_s:g} s has no duration")
    # The tolerance keeps 5 s at 100 Hz at 500 steps, whatever the last bit of their product.
    steps = max(1, math.ceil(duration_s * rate_hz * (1 - 1e-12)))
    return np.linspace(0.0, duration_s, steps + 1)


def assemble(
    joints: tuple[str, ...], time_s: FloatArray, angle_deg: list[FloatArray], period_s: float | None
) -> Trajectory:
    """Return the trajectory of angles given in degrees, one array a joint."""
    return Trajectory(joints, time_s, np.radians(np.column_stack(angle_deg)), period_s)


def positive_frequency(value: float, joint: str) -> float:
    """Return a frequency if it is one.

    Raises
    ------
    SpecError
        It is not above zero.
    """
    if value <= 0:
        raise SpecError(f"gait.joints.{joint}.frequency_hz is {value:g} Hz; it must be above 0 Hz")
    return value
