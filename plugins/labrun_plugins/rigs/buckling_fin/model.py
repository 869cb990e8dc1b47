"""The fin model as a labrun model: one wing on a mount, or a swimmer of two fins; see `equations`.

Functions of the model signature ``(t, x, u, p, force, out)``.
"""

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from labrun.models import Input, Model, Output, Site, natives
from labrun_plugins.rigs.buckling_fin.equations import PARAMETERS, STATES, base_torque, hinge_torque, motion

Free = Literal["x", "y", "yaw"]
OUTPUTS = (
    Output("force_x", "N"), Output("force_y", "N"), Output("torque_z", "N m"),
    Output("x", "m"), Output("y", "m"), Output("yaw", "rad"),
    Output("base_1", "rad"), Output("bend_1", "rad"), Output("hinge_1", "N m"), Output("servo_1", "N m"),
    Output("base_2", "rad"), Output("bend_2", "rad"), Output("hinge_2", "N m"), Output("servo_2", "N m"),
    Output("base_rate_1", "rad/s"), Output("base_rate_2", "rad/s"), Output("speed", "m/s"),
    Output("acceleration", "m/s^2"),
)  # fmt: skip
"""Load on the mount; where the body is; of each fin the angle of its base, the bend of its hinge (negative in equal
sense), the torque in the hinge, and what the servo turns with; rates of the bases; speed and acceleration along x."""

SITES = (
    Site("hinge_1", "joint", "bend_1", "bend_rate_1", load="hinge_1", stiffness="stiffness"),
    Site("hinge_2", "joint", "bend_2", "bend_rate_2", load="hinge_2", stiffness="stiffness"),
    Site("plate_1", "body", "way of the plate along its normal", "speed of the plate along its normal"),
    Site("plate_2", "body", "way of the plate along its normal", "speed of the plate along its normal"),
    Site("body", "body", "x", "speed"),
)


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """Write rates of the states: see `equations.STATES`. Inputs: what the servos are told, rad."""
    body, _, left, right, bend_l, bend_r = motion(x, u, p, force)
    for i in range(3):
        dx[i] = x[3 + i]
        dx[3 + i] = body[i]
    dx[6], dx[7], dx[8], dx[9] = x[7], left[10], x[9], bend_l
    dx[10], dx[11], dx[12], dx[13] = x[11], right[10], x[13], bend_r


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Write outputs: see `OUTPUTS`."""
    body, mount, left, right, _, _ = motion(x, u, p, force)
    for i in range(3):
        y[i] = mount[i]
        y[3 + i] = x[i]
    y[6], y[7], y[8], y[9] = x[6], x[8], hinge_torque(x[8], p), base_torque(left, body)
    y[10], y[11], y[12], y[13] = x[10], x[12], hinge_torque(x[12], p), base_torque(right, body)
    y[14], y[15], y[16], y[17] = x[7], x[11], x[3], body[0]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Write of both hinges, both plates and the body coordinate, rate, load, stiffness."""
    _, _, left, right, _, _ = motion(x, u, p, force)
    for i in range(20):
        values[i] = 0.0
    for i in range(2):
        bend = x[8 + 4 * i]
        values[4 * i], values[4 * i + 1] = bend, x[9 + 4 * i]
        values[4 * i + 2], values[4 * i + 3] = hinge_torque(bend, p), p[0]
        values[8 + 4 * i] = (p[8] + p[9]) * x[6 + 4 * i] + p[9] * bend
    values[9], values[13] = left[13], right[13]
    values[16], values[17] = x[0], x[3]


def fin_model(name: str, *, fins: int, free: Sequence[Free] = ()) -> Model:
    """Return the model of a body with one or two fins.

    Parameters
    ----------
    name
        Of the model.
    fins
        2, or 1: the left one alone. The second servo is told something all the same, and what its fin does is not felt.
    free
        In which ways the body moves; in the others the mount holds it.
    """
    ways = [float(way in free) for way in ("x", "y", "yaw")]
    return Model(
        name=name,
        states=STATES,
        inputs=(Input("told_1", "rad"), Input("told_2", "rad")),
        outputs=OUTPUTS,
        parameters=PARAMETERS,
        sites=SITES,
        initial=dict.fromkeys(STATES, 0.0),
        **natives(derivative, output, site_values),
        constants=np.array([*ways, float(fins)]),
        source="fins on buckling hinges",
    )
