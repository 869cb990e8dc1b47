"""The stabiliser's laminate between servos and end-effector, and the hand that moves the base.

Each axis of the end-effector is a mass on the spring of the laminate (hinges that twist, links that bend), driven by
its servo; its weight above the centre of rotation makes it sag towards where it leans in the room::

    I theta_1'' = k (servo_1 - theta_1) - b theta_1' + G sin(theta_1 - base_x)
    I theta_2'' = k (servo_2 - theta_2) - b theta_2' + G sin(theta_2 + base_y)

(theta_1 turns about -x, theta_2 about y; small angles, the axes do not couple.) Left out: the base's angular
acceleration, which bends the laminate by less than 0.03 degrees. The base leans about x and y by white noise through a
Butterworth low pass of fourth order, a stand-in for a hand that shakes it at random. Functions of the model signature
``(t, x, u, p, force, out)``; see `labrun.models`.
"""

import math
from typing import Any

from labrun.models import Input, Model, Output, Parameter, Site, natives

_SLOW = 2.0 * math.cos(math.pi / 8.0)
_SHARP = 2.0 * math.sin(math.pi / 8.0)
"""Damping terms of the two sections of a fourth-order Butterworth filter."""
_VARIANCE = 8.0 * math.sin(math.pi / 8.0)
"""White noise of intensity S leaves that filter with the variance S omega / this."""

STATES = (
    "theta_1", "theta_1_rate", "theta_2", "theta_2_rate",
    "hand_x", "hand_x_rate", "base_x", "base_x_rate", "hand_y", "hand_y_rate", "base_y", "base_y_rate",
)  # fmt: skip
INPUTS = ("servo_1", "servo_2", "noise_x", "noise_y")
OUTPUTS = ("theta_1", "theta_2", "base_x", "base_y")


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """Rates of the states; parameters: k, b, I, G, rms of the base's tilt (rad), its bandwidth (rad/s)."""
    dx[0] = x[1]
    dx[1] = (p[0] * (u[0] - x[0]) - p[1] * x[1] + p[3] * math.sin(x[0] - x[6]) + force[0]) / p[2]
    dx[2] = x[3]
    dx[3] = (p[0] * (u[1] - x[2]) - p[1] * x[3] + p[3] * math.sin(x[2] + x[10]) + force[1]) / p[2]
    omega = p[5]
    loudness = p[4] * math.sqrt(_VARIANCE / omega)
    for axis in range(2):
        i = 4 + 4 * axis
        dx[i] = x[i + 1]
        dx[i + 1] = omega * (omega * (loudness * u[2 + axis] - x[i]) - _SLOW * x[i + 1])
        dx[i + 2] = x[i + 3]
        dx[i + 3] = omega * (omega * (x[i] - x[i + 2]) - _SHARP * x[i + 3])


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Angles of the mechanism and tilts of the base, rad."""
    y[0] = x[0]
    y[1] = x[2]
    y[2] = x[6]
    y[3] = x[10]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Sites ``axis_1`` and ``axis_2``: angle, rate, load (none is modelled), stiffness."""
    for axis in range(2):
        values[4 * axis] = x[2 * axis]
        values[4 * axis + 1] = x[2 * axis + 1]
        values[4 * axis + 2] = 0.0
        values[4 * axis + 3] = p[0]


def spm_model(base_tilt_rad: float, base_bandwidth_hz: float) -> Model:
    """Return the model of mechanism and moved base.

    Chosen, as the source has no figures: an end-effector of 30 g with its camera, 25 mm from the centre of rotation
    (I = 2e-5 kg m^2; 20 mm of it above the centre, G = 6 mN m), on a laminate that lets it swing at 12 Hz with damping
    ratio 0.2 (k = 0.114 N m/rad, b = 6e-4 N m s/rad). It sags by 5 % of its lean: half a degree at 10 degrees.

    Parameters
    ----------
    base_tilt_rad
        Root mean square of the base's tilt about each axis.
    base_bandwidth_hz
        Frequency above which the base hardly moves.
    """
    return Model(
        name="spm-stabiliser",
        states=STATES,
        inputs=tuple(Input(name) for name in INPUTS),
        outputs=tuple(Output(name, "rad") for name in OUTPUTS),
        parameters=(
            Parameter("stiffness", 0.114, unit="N m/rad", lower=0.0),
            Parameter("damping", 6e-4, unit="N m s/rad", lower=0.0),
            Parameter("inertia", 2e-5, unit="kg m^2", lower=0.0),
            Parameter("gravity_torque", 6e-3, unit="N m", lower=0.0),
            Parameter("base_tilt", base_tilt_rad, unit="rad", lower=0.0),
            Parameter("base_bandwidth", 2.0 * math.pi * base_bandwidth_hz, unit="rad/s", lower=0.0),
        ),
        sites=(
            Site("axis_1", "joint", coordinate="theta_1", rate="theta_1_rate", stiffness="stiffness"),
            Site("axis_2", "joint", coordinate="theta_2", rate="theta_2_rate", stiffness="stiffness"),
        ),
        initial=dict.fromkeys(STATES, 0.0),
        **natives(derivative, output, site_values),
        source="simulated stabiliser",
    )
