"""A hinge that is turned: torque of a spring and a damper, of which a share is left.

Functions of the model signature ``(t, x, u, p, force, out)``; see `labrun.models`.
"""

from typing import Any

from labrun.models import Input, Model, Output, Parameter, Site, native

LAG_S = 0.02
"""Of sensor and mount (chosen)."""
STIFFNESS, DAMPING = 0.0686, 2.886e-4
"""N m/rad and N m s/rad: the hinge of Table 3.2, for want of another."""


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """State: angle (rad), which follows the servo. Inputs: angle of the servo (rad), share of torque that is left."""
    dx[0] = (u[0] - x[0]) / p[2]


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Output: torque on the mount (N m)."""
    y[0] = u[1] * (p[0] * x[0] + p[1] * (u[0] - x[0]) / p[2]) - force[0]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Site ``hinge``: angle, rate, load (its torque), stiffness."""
    values[0] = x[0]
    values[1] = (u[0] - x[0]) / p[2]
    values[2] = u[1] * p[0] * x[0]
    values[3] = u[1] * p[0]


def turned_hinge() -> Model:
    """Return the model of a new hinge."""
    return Model(
        name="life-bench",
        states=("angle",),
        inputs=(Input("servo", "rad"), Input("left")),
        outputs=(Output("torque_z", "N m"),),
        parameters=(
            Parameter("stiffness", STIFFNESS, unit="N m/rad", lower=0.0),
            Parameter("damping", DAMPING, unit="N m s/rad", lower=0.0),
            Parameter("lag", LAG_S, 0.0, unit="s", lower=1e-3),
        ),
        conditions=(),
        sites=(Site("hinge", "joint", "angle", "rate", load="load", stiffness="stiffness"),),
        initial={"angle": 0.0},
        derivative=native("model", derivative),
        output=native("model", output),
        site_values=native("model", site_values),
        source="simulated life bench",
    )
