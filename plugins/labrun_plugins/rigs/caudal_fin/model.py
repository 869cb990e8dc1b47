"""Thrust of a flapping tail in a small tank: the equations behind `caudal_tank`.

Functions of the model signature ``(t, x, u, p, force, out)``; see `labrun.models`.
What the source states: static gain, lags and dead times of thrust against amplitude (5.5) and of its
direction against offset (5.6), the best gait, and that most others push backwards, for which it suspects
waves that come back from the walls; and that thrust is not straight in
amplitude (Table 5.3). The rest is chosen for the simulation, and said so.
"""

import math
from typing import Any

import numpy as np

from labrun.errors import SpecError
from labrun.models import Input, Model, Output, Parameter, Site, natives

BEST_N = 0.551
"""Mean thrust of the fin the source took, large, 1.016 mm of polyester, at 60 deg and 1.4 Hz: the tank's own gain."""
SMALL_SHARE = 0.91
"""Thrust of a small fin over that of a large one, where the table has one of them only: the mean of the two thicknesses
that it has both of is 0.913 (chosen)."""
POLYESTER_N = {
    "small": {0.254: 0.2361, 0.508: 0.2944},
    "large": {0.254: 0.2647, 0.508: 0.3154, 1.016: 0.551, 1.524: 1.157},
}
"""Table 5.2, N over thickness in mm."""
ACRYLIC_MM, ACRYLIC_N = 6.35, 0.1983
"""The acrylic tail, which was made in one size, counted as small."""


def thrust_n(material: str, thickness_mm: float, fin: str) -> float:
    """Return the mean thrust of a fin at 60 deg and 1.4 Hz, N; straight in thickness between the rows of Table 5.2.

    Raises SpecError: a fin that the table does not reach.
    """
    if fin not in POLYESTER_N:
        raise SpecError(f"this tank has no {fin!r} fin", hint="it has small and large ones")
    if material == "acrylic":
        if fin != "small" or abs(thickness_mm - ACRYLIC_MM) > 1e-9:
            raise SpecError(
                f"Table 5.2 has one acrylic tail, small and of {ACRYLIC_MM:g} mm; asked for was a {fin} one of "
                f"{thickness_mm:g} mm"
            )
        return ACRYLIC_N
    if material != "polyester":
        raise SpecError(f"this tank has no fin of {material!r}", hint="it has polyester and acrylic")
    large = POLYESTER_N["large"]
    known = dict(large)
    if fin == "small":
        known = {mm: SMALL_SHARE * force_n for mm, force_n in large.items()} | POLYESTER_N["small"]
    thicknesses = sorted(known)
    if not thicknesses[0] <= thickness_mm <= thicknesses[-1]:
        raise SpecError(
            f"a fin of {thickness_mm:g} mm is beyond Table 5.2",
            hint=f"it has {thicknesses[0]:g} to {thicknesses[-1]:g} mm of polyester",
        )
    return float(np.interp(thickness_mm, thicknesses, [known[mm] for mm in thicknesses]))


BEST_HZ = 1.4
"""Frequency at which the returning wave meets the tail in phase (best gait of section 5.2)."""
ECHO_S = 1.0 / BEST_HZ
"""Time from a stroke until its wave is back: one period at the best frequency, which makes it the best."""
TIP_LAG_S = 0.1
"""The flexible sheet's tip follows the servo with this lag (chosen)."""
SERVO_DELAY_S = 0.05
"""(5.5) and (5.6) count from the command. An RC servo of 6 Hz that takes 50 commands/s is behind by about this."""
SERVO_SHARE = 0.98
"""And about this much of a commanded amplitude arrives at the tail at the best frequency."""
ANGLE_DEAD_S = 0.12 - SERVO_DELAY_S
"""Dead time of eq. (5.6), less the servo's."""
AMPLITUDE_DEAD_S = 0.28 - TIP_LAG_S
"""Dead time of eq. (5.5), less the tip's lag, which acts like a part of it.

The servo's does not come on top: a tail at rest is at half its stroke's speed before the servo has caught up.
"""

_AMPLITUDE_LAG_S = 0.34
_ANGLE_LAG_S = 0.13
_OMEGA = 2.0 * math.pi * BEST_HZ
_TIP_GAIN = 1.0 / math.sqrt(1.0 + (_OMEGA * TIP_LAG_S) ** 2)
# Mean of |sin| is 2/pi: with this factor the mean of |tip speed| is the commanded amplitude, at the best frequency.
_TO_AMPLITUDE = math.pi / (2.0 * _OMEGA * _TIP_GAIN * SERVO_SHARE)
_SWING_GAIN = 0.5 / (1.0 + (_OMEGA * _ANGLE_LAG_S) ** 2) / (_OMEGA * _TIP_GAIN) ** 2

QUARTER_S = 0.25 / BEST_HZ
"""A rate and the one this long before it give the amplitude at any moment of a stroke (best frequency)."""
_BEND_FROM_RAD = math.radians(40.0)
_BEND_WIDTH_RAD = math.radians(20.0)
_BEND_RAD = math.radians(5.0)
"""Between 40 and 60 deg thrust rises first faster, then slower than the line of (5.5), by at most so much (chosen)."""

_ECHO_STRENGTH = 1.5
_LEFT_OVER_SHARE = 0.5
_LEFT_OVER_S = 4.0
_TURN_BACK_S = 0.5
_TURN_BACK_ABOVE = 1.3
"""The jet turns back once it is this much stronger than the stroke that feeds it."""
_JET_BUILD_UP_S = 2.0
_VORTEX_S = 3.0
_QUIET = 2.5e-3
_WAVE_SHARE = 0.03
_WAVE_DAMPING = 0.03
# First sloshing modes of water 0.2 m deep, along 0.3048 m and across 0.1524 m:
# omega^2 = g k tanh(k h), k = pi / length.
_ALONG = 2.0 * math.pi * 1.575
_ACROSS = 2.0 * math.pi * 2.263

STATES = (
    "stroke", "stroke_smooth", "jet", "left_over", "power", "echo_power", "echo_product", "direction",
    "vortex_x", "vortex_y", "wave_x", "wave_x_rate", "wave_y", "wave_y_rate",
)  # fmt: skip


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """Rates of the states.

    Inputs: tip angle and rate; tip rate one dead time ago, one echo before that, and a quarter of a stroke before
    it; servo angle one angle dead time ago; rates of the fin's own momentum (below); two white noises.

    The fin drags water along: ``m = (rate sin(angle), rate cos(angle))`` times `entrained` is its momentum, forward and
    sideways, and what changes it pushes back on the fish. Over whole cycles, and over a move from rest to rest, that
    push comes to nothing, as the source's side force does.
    """
    late_rate, echo_rate, quarter_rate = u[2], u[3], u[4]
    # Above 40 deg the thrust rises faster than the line of (5.5), then saturates and is on the line again at 60 deg.
    # This bends the stroke before its lag, so that steps keep the lag of (5.5).
    amplitude = math.sqrt(late_rate * late_rate + quarter_rate * quarter_rate) / (_OMEGA * _TIP_GAIN)
    place = min(1.0, max(0.0, (amplitude - _BEND_FROM_RAD) / _BEND_WIDTH_RAD))
    bend = p[6] * 16.0 * (place * (1.0 - place)) ** 2
    dx[0] = (abs(late_rate) * _TO_AMPLITUDE + bend - x[0]) / _AMPLITUDE_LAG_S
    dx[1] = (x[0] - x[1]) / _AMPLITUDE_LAG_S
    # When the tail stops driving, the jet turns at the wall and comes back as a current that dies out in seconds.
    # It follows a stroke that weakens slowly.
    turning = max(0.0, x[2] - _TURN_BACK_ABOVE * x[1])
    dx[2] = (x[1] - x[2]) / _JET_BUILD_UP_S - turning / _TURN_BACK_S
    dx[3] = p[4] * turning / _TURN_BACK_S - x[3] / _LEFT_OVER_S
    dx[4] = (late_rate * late_rate - x[4]) / _AMPLITUDE_LAG_S
    dx[5] = (echo_rate * echo_rate - x[5]) / _AMPLITUDE_LAG_S
    dx[6] = (late_rate * echo_rate - x[6]) / _AMPLITUDE_LAG_S
    dx[7] = (p[1] * u[5] - x[7]) / _ANGLE_LAG_S
    stirring = math.sqrt(2.0 / _VORTEX_S) * p[5] * x[2]
    dx[8] = stirring * u[8] - x[8] / _VORTEX_S
    dx[9] = stirring * u[9] - x[9] / _VORTEX_S
    dx[10] = x[11]
    dx[11] = _ALONG * _ALONG * (-p[2] * u[6] - x[10]) - 2.0 * _WAVE_DAMPING * _ALONG * x[11]
    dx[12] = x[13]
    dx[13] = _ACROSS * _ACROSS * (-p[2] * u[7] - x[12]) - 2.0 * _WAVE_DAMPING * _ACROSS * x[13]


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Forward and side force on the fish, N."""
    # 0 where the returning wave is in phase with the tail (or there is none yet), 2 in antiphase, whichever of the two
    # is stronger: a tail that beats ever more softly at the best frequency stays in phase with its stronger waves. The
    # first wave to come back, weaker than the tail's own, counts by its power alone and changes the thrust smoothly.
    shared = min(x[5], math.sqrt(max(0.0, x[4] * x[5])))
    discord = max(0.0, shared - x[6]) / (0.5 * (x[4] + x[5]) + _QUIET)
    gain = 1.0 - 2.0 * math.tanh(_ECHO_STRENGTH * p[3] * discord)
    # The jet swings with the tail; its mean is weaker than its strength by J0(swing), which (5.5) contains.
    swing = 1.0 + p[1] * p[1] * _SWING_GAIN * x[4]
    jet = p[0] * x[0] * gain * swing
    wave_x, wave_y = _WAVE_SHARE * x[10], _WAVE_SHARE * x[12]
    y[0] = (
        jet * math.cos(x[7])
        - p[0] * x[3]
        + x[8]
        - p[2] * u[6]
        + wave_x
        + force[0]
        + force[1] * math.sin(u[0])
    )
    y[1] = jet * math.sin(x[7]) + x[9] - p[2] * u[7] + wave_y + force[1] * math.cos(u[0])


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Sites ``fish`` and ``fin``.

    The fish is held still; its force adds to the thrust, and its speed is the returning current's. The fin's coordinate
    is the tip's angle, and a force on it stands square to the sheet.
    """
    values[0] = 0.0
    values[1] = x[3]
    values[2] = 0.0
    values[3] = 0.0
    values[4] = u[0]
    values[5] = u[1]
    values[6] = 0.0
    values[7] = 0.0


def caudal_model() -> Model:
    """Return the model; its parameters are those of (5.5), (5.6), and what is chosen besides."""
    inputs = (
        "tip_angle",
        "tip_rate",
        "tip_rate_late",
        "tip_rate_echo",
        "tip_rate_quarter",
        "servo_angle_late",
        "momentum_x_rate",
        "momentum_y_rate",
        "noise_x",
        "noise_y",
    )
    return Model(
        name="caudal-tank",
        states=STATES,
        inputs=tuple(Input(name) for name in inputs),
        outputs=(Output("force_x", "N"), Output("force_y", "N")),
        parameters=(
            Parameter("thrust_gain", math.degrees(0.00912), unit="N/rad"),
            Parameter("direction_gain", -0.866, unit="rad/rad"),
            Parameter("entrained", 0.004, unit="kg m"),
            Parameter("echo", 1.0),
            Parameter("left_over", _LEFT_OVER_SHARE),
            Parameter("vortices", 0.035, unit="N/rad"),
            Parameter("bend", _BEND_RAD, unit="rad"),
        ),
        sites=(
            Site("fish", "body", coordinate="0", rate="left_over"),
            Site("fin", "body", coordinate="tip_angle", rate="tip_rate", unit="rad"),
        ),
        initial=dict.fromkeys(STATES, 0.0),
        **natives(derivative, output, site_values),
        source="simulated caudal tank",
    )
