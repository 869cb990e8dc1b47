"""The hinge pendulum's equation of motion, eq. (3.5) with its gravity term corrected.

``(I_G + m r^2) theta'' = -k theta - b theta' - m g r sin(theta)``: the printed gravity term lacks the r.
Functions of the model signature ``(t, x, u, p, force, out)``; see `labrun.models`.
"""

import math
from typing import Any

from labrun.models import Input, Model, Output, Parameter, Site, native


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """State: angle (rad), rate (rad/s). Inputs: scale of stiffness and of damping in this release."""
    dx[0] = x[1]
    dx[1] = (force[0] - p[0] * u[0] * x[0] - p[1] * u[1] * x[1] - p[3] * math.sin(x[0])) / p[2]


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Output: angle (rad)."""
    y[0] = x[0]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Site ``hinge``: angle, rate, load (the weight's torque), stiffness in this release."""
    values[0] = x[0]
    values[1] = x[1]
    values[2] = p[3] * math.sin(x[0])
    values[3] = p[0] * u[0]


def hinge_model(stiffness: float, damping: float, inertia: float, gravity_torque: float) -> Model:
    """Return the pendulum with these parameters: N m/rad, N m s/rad, kg m^2, N m."""
    return Model(
        name="hinge-bench",
        states=("angle", "rate"),
        inputs=(Input("stiffness_scale"), Input("damping_scale")),
        outputs=(Output("angle", "rad"),),
        parameters=(
            Parameter("stiffness", stiffness, unit="N m/rad", lower=0.0),
            Parameter("damping", damping, unit="N m s/rad", lower=0.0),
            Parameter("inertia", inertia, 0.03, unit="kg m^2", lower=0.0),
            Parameter("gravity_torque", gravity_torque, 0.03, unit="N m", lower=0.0),
        ),
        conditions=(),
        sites=(
            Site("hinge", "joint", "angle", "rate", load="gravity_torque*sin(angle)", stiffness="stiffness"),
        ),
        initial={"angle": 0.0, "rate": 0.0},
        derivative=native("model", derivative),
        output=native("model", output),
        site_values=native("model", site_values),
        source="simulated hinge bench",
    )
