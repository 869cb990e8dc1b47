"""The fish let loose: a rigid body that goes ahead, aside and about its vertical axis, in water that stirs it.

Kirchhoff's equations of a body in an ideal fluid, in the plane (Lamb, Hydrodynamics (1932), section 124), with the
loads of the fins and quadratic drag,

    ``m_a u' =  m_s v r + F_x - c_a u|u|``
    ``m_s v' = -m_a u r + F_y - c_s v|v|``
    ``I r'   = (m_a - m_s) u v + N_z - c_r r|r|``

with u ahead, v to the left, r the turn to the left, m_a and m_s the masses with the water that moves along.
Without fins and drag they keep the kinetic energy. Functions of the model signature ``(t, x, u, p, force, out)``;
see `labrun.models`.
"""

import math
from typing import Any

from labrun.models import Input, Model, Output, Parameter, Site, native

REAR_FINS_YAW_DRAG = 0.041
"""What a tail at rest and the dorsal fin add to the yaw drag, N m s^2."""

STATES = ("x", "y", "heading", "ahead", "aside", "turning", "stirring", "vortex_x", "vortex_y", "vortex_yaw")
OUTPUTS = (
    Output("x", "m"), Output("y", "m"), Output("heading", "rad"),
    Output("ahead", "m/s"), Output("aside", "m/s"), Output("turning", "rad/s"),
)  # fmt: skip
_INPUTS = ("fin_force_x", "fin_force_y", "fin_torque_z", "fin_size", "noise_x", "noise_y", "noise_yaw")
_STIRRING_S = 2.0
_VORTEX_S = 2.0
_VORTEX_LONG_M = 0.15
_FINS_OUT_M = 0.13
"""How far from the axis of the turn the fins stir the water, m."""


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """Rates of the states: place and heading, speeds, how much the water is stirred, vortices."""
    ahead, aside, turning = x[3], x[4], x[5]
    cosine, sine = math.cos(x[2]), math.sin(x[2])
    dx[0] = cosine * ahead - sine * aside
    dx[1] = sine * ahead + cosine * aside
    dx[2] = turning
    push_x = u[0] + x[7] - p[3] * ahead * abs(ahead) + force[0]
    push_y = u[1] + x[8] - p[4] * aside * abs(aside)
    twist = u[2] + x[9] - p[5] * turning * abs(turning) + force[1]
    dx[3] = (p[1] * aside * turning + push_x) / p[0]
    dx[4] = (-p[0] * ahead * turning + push_y) / p[1]
    dx[5] = ((p[0] - p[1]) * ahead * aside + twist) / p[2]
    strength = math.sqrt(2.0 / _VORTEX_S) * x[6]
    dx[6] = (u[3] - x[6]) / _STIRRING_S
    # Vortices die out, and a fish that goes and turns leaves them behind, as on the arm.
    leaving = math.sqrt(ahead * ahead + aside * aside) + _FINS_OUT_M * abs(turning)
    fading = 1.0 / _VORTEX_S + leaving / _VORTEX_LONG_M
    dx[7] = p[6] * strength * u[4] - fading * x[7]
    dx[8] = p[6] * strength * u[5] - fading * x[8]
    dx[9] = p[7] * strength * u[6] - fading * x[9]


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Where the fish is and how it goes."""
    for i in range(6):
        y[i] = x[i]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Sites ``fish``, a body that goes ahead through the water, and ``turn``, one that turns in it."""
    values[0] = x[0]
    values[1] = x[3]
    values[2] = 0.0
    values[3] = 0.0
    values[4] = x[2]
    values[5] = x[5]
    values[6] = 0.0
    values[7] = 0.0


def free_model() -> Model:
    """Return the model of the free fish.

    Mass 2 kg ahead, with the water that moves along, as on the arm; half as much again aside, 0.05 kg m^2 about the
    vertical axis (a rod of 0.542 m and 2 kg); a hull whose drag, 0.8 N s^2/m^2, is less than half of that with the
    mount at the arm; drag aside of a plate 0.4 m long and 0.1 m high (all chosen). The yaw drag, and what tail and
    dorsal fin add to it, are set so that the fastest of the gaits that win on the arm turn the fish with about
    the 30.25 and 15.68 deg/s of the source, without noise. They are small: a stiff hull and tail square to the flow
    would have some ten times as much by the law of the fins, and fins that ahead push no more than the source's could
    not turn them so fast.
    """
    return Model(
        name="fire-free",
        states=STATES,
        inputs=tuple(Input(name) for name in _INPUTS),
        outputs=OUTPUTS,
        parameters=(
            Parameter("mass", 2.0, unit="kg"),
            Parameter("mass_aside", 3.0, unit="kg"),
            Parameter("inertia", 0.05, unit="kg m^2"),
            Parameter("hull_drag", 0.8, unit="N s^2/m^2"),
            Parameter("drag_aside", 40.0, unit="N s^2/m^2"),
            Parameter("yaw_drag", 0.006, unit="N m s^2"),
            Parameter("vortices", 0.04),
            Parameter("yaw_vortices", 0.0045, unit="m"),
        ),
        conditions=(),
        sites=(
            Site("fish", "body", coordinate="x", rate="ahead"),
            Site("turn", "joint", coordinate="heading", rate="turning"),
        ),
        initial=dict.fromkeys(STATES, 0.0),
        derivative=native("model", derivative),
        output=native("model", output),
        site_values=native("model", site_values),
        source="simulated free fish",
    )
