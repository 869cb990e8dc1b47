"""A body that turns on a pin, pulled by a servo's horn through an elastic strip, in whatever orientation to gravity.

``I angle'' = k (base - angle) + b (base' - angle') - up G sin(angle + tilt) - friction tanh(angle' / v) - drag``, where
``G = g (moment + payload payload_lever)`` and ``I = inertia + payload payload_lever^2``: the strip pulls the body
towards the horn (k and b go with its width), the pin sits in the frame and rubs, and the bench may hang the other way
up (``up`` = -1). v = 0.02 rad/s, where friction is three quarters of its full size, is chosen.
Functions of the model signature ``(t, x, u, p, force, out)``; see `labrun.models`.
"""

import math
from typing import Any

from labrun.models import Input, Model, Output, Parameter, Site, native


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """State: angle (rad), and rate less ``b / I`` times the horn's angle (rad/s): damping needs no derivative so.

    Inputs: angle of the horn (rad), orientation (+1 or -1), payload (kg), strip (1: 25 mm wide).
    """
    inertia = p[2] + u[2] * p[4] * p[4]
    gravity = 9.81 * u[1] * (p[3] + u[2] * p[4])
    rate = x[1] + p[1] * u[3] / inertia * u[0]
    dx[0] = rate
    dx[1] = (
        force[0]
        + p[0] * u[3] * (u[0] - x[0])
        - p[1] * u[3] * rate
        - gravity * math.sin(x[0] + p[6])
        - p[7] * math.tanh(rate / 0.02)
        - p[8] * rate * abs(rate)
    ) / inertia


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Output: angle of the body and of the horn (rad)."""
    y[0] = x[0]
    y[1] = u[0]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Site ``hinge``: angle, rate, load (weight on the pin times the pin's radius), stiffness of the strip."""
    inertia = p[2] + u[2] * p[4] * p[4]
    values[0] = x[0]
    values[1] = x[1] + p[1] * u[3] / inertia * u[0]
    values[2] = 9.81 * (p[9] + u[2]) * p[5]
    values[3] = p[0] * u[3]


def driven_joint_model(*, friction_n_m: float, drag: float) -> Model:
    """Return the bench's model: friction in the pin (N m), and drag of the air (N m s^2/rad^2).

    All numbers are chosen: an aluminium arm of 60 g on a steel strip of 0.3 N m/rad (25 mm wide), which swings at
    4.3 Hz with 40 g at its end, and at 3.5 Hz turned over, where gravity pulls it away from the horn.
    """
    return Model(
        name="driven-joint",
        states=("angle", "swing"),
        inputs=(
            Input("base", "rad"),
            Input("up"),
            Input("payload", "kg"),
            Input("strip"),
        ),
        outputs=(Output("angle", "rad"), Output("horn", "rad")),
        parameters=(
            Parameter("stiffness", 0.3, unit="N m/rad", lower=1e-3),
            Parameter("damping", 2.5e-3, unit="N m s/rad", lower=0.0),
            Parameter("inertia", 2.5e-4, unit="kg m^2", lower=1e-6),
            Parameter("moment", 3.0e-3, unit="kg m", lower=0.0),
            Parameter("payload_lever", 0.08, unit="m", lower=0.0),
            Parameter("radius", 0.01, unit="m", lower=0.0),
            Parameter("tilt", 0.0, unit="rad"),
            Parameter("friction", friction_n_m, unit="N m", lower=0.0),
            Parameter("drag", drag, unit="N m s^2/rad^2", lower=0.0),
            Parameter("mass", 0.06, unit="kg", lower=0.0),
        ),
        conditions=(),
        sites=(Site("hinge", "joint", "angle", "rate", load="weight on the pin", stiffness="stiffness"),),
        initial={"angle": 0.0, "swing": 0.0},
        derivative=native("model", derivative),
        output=native("model", output),
        site_values=native("model", site_values),
        source="simulated driven joint",
    )
