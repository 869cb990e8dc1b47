"""Largest and smallest torque of a cycle of the wing in water, as Table 7.2 of the source work prints them.

A table has one row for each frequency, and no course over time: this model's outputs are functions of the frequency.
Inside them the fin of `equations` is integrated over a cycle and a half, and the last cycle looked at. It stands for
the source's own simulation, so that nothing in it can be adjusted: what it lacks is to be told.
"""

import math
from typing import Any

import numpy as np

from labrun.models import Model, Output, kernel, natives
from labrun_plugins.rigs.buckling_fin.equations import PARAMETERS, base_torque, fin

_OF_A_WING = 13
_STROKE_RAD = math.radians(66.0)
"""Not stated for water; that of the wing in air (section 7.5)."""
_STEP_S = 0.0025
_CYCLES = 1.5


@kernel
def _values(p: Any) -> Any:
    """Return the fin's numbers, which stand behind the frequency; the servo's axis is the mount's."""
    return (
        p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11], p[12], p[13], 0.0, 0.0, 0.0,
    )  # fmt: skip


@kernel
def _fin_at(t: float, bend: float, bend_rate: float, natural_rad_s: float, p: Any) -> Any:
    """Return the held fin while its base follows the sine exactly: its servo is told what makes it do so."""
    base = _STROKE_RAD * math.sin(natural_rad_s * t)
    rate = _STROKE_RAD * natural_rad_s * math.cos(natural_rad_s * t)
    servo = 2.0 * math.pi * p[11]
    damped = base + (2.0 * p[12] * servo * rate - natural_rad_s * natural_rad_s * base) / (servo * servo)
    return fin(1.0, 6, damped, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, base, rate, bend, bend_rate), p, 0.0, 0.0)


@kernel
def _bends(wing: Any, p: Any) -> float:
    """Return how the rate of the bend changes, rad/s^2."""
    return float((wing[6] / wing[14] - wing[9]) / p[9])


@kernel
def extremes(frequency_hz: float, p: Any) -> Any:
    """Return largest and smallest torque of the frame, N m: the power stroke is positive."""
    turn = 2.0 * math.pi * frequency_hz
    count = math.ceil(_CYCLES / (frequency_hz * _STEP_S))
    h = _CYCLES / (frequency_hz * count)
    bend = bend_rate = 0.0
    largest, smallest = -math.inf, math.inf
    for i in range(count):
        t = i * h
        fin_state = _fin_at(t, bend, bend_rate, turn, p)
        if t >= (_CYCLES - 1.0) / frequency_hz:
            torque = -base_torque(fin_state, (0.0, 0.0, 0.0))
            largest, smallest = max(largest, torque), min(smallest, torque)
        a1 = _bends(fin_state, p)
        v2 = bend_rate + 0.5 * h * a1
        a2 = _bends(_fin_at(t + 0.5 * h, bend + 0.5 * h * bend_rate, v2, turn, p), p)
        v3 = bend_rate + 0.5 * h * a2
        a3 = _bends(_fin_at(t + 0.5 * h, bend + 0.5 * h * v2, v3, turn, p), p)
        v4 = bend_rate + h * a3
        a4 = _bends(_fin_at(t + h, bend + h * v3, v4, turn, p), p)
        bend += h / 6.0 * (bend_rate + 2.0 * v2 + 2.0 * v3 + v4)
        bend_rate += h / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    return largest, smallest


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:
    """No state changes: the cycle is integrated in the outputs."""


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Write the extremes at the condition ``frequency_hz``."""
    y[0], y[1] = extremes(p[0], _values(p))


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:
    """No site takes a force: effects sit at the two outputs."""


def wing_extremes() -> Model:
    """Return the model of the table's rows."""
    return Model(
        name="table-7-2",
        states=(),
        inputs=(),
        outputs=(Output("power_stroke", "N m"), Output("recovery_stroke", "N m")),
        parameters=(),
        conditions=("frequency_hz",),
        sites=(),
        initial={},
        **natives(derivative, output, site_values),
        constants=np.array([parameter.value for parameter in PARAMETERS[:_OF_A_WING]]),
        source="cycles of a wing on a buckling hinge in water",
    )
