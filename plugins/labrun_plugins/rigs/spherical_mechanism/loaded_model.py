"""The larger mechanism under load: laminate between horns and end-effector, its weight, and what hangs on it.

Each axis of the end-effector is pulled by its horn through the laminate, which damps the motion, and topples outwards
by its weight and that of the load (section 4.6.1 of the source: links and hinges bend under their own weight, and more
under load)::

    (I + m l^2) theta'' = k (horn - theta) - b theta' + (G + m g h) sin(theta) + side m g l pull

``side`` is +1 for axis 1 and -1 for axis 2, m the load's mass, h its height above the centre of rotation, l how far it
hangs to the side, ``pull`` 1 but for a load that moves. Functions of the model signature ``(t, x, u, p, force, out)``.
"""

import math
from typing import Any

from labrun.models import Input, Model, Output, Parameter, Site, natives

STATES = ("theta_1", "theta_1_rate", "theta_2", "theta_2_rate")
INPUTS = ("servo_1", "servo_2", "load", "pull_1", "pull_2")
OUTPUTS = ("theta_1", "theta_2")
_G = 9.81
_STIFFNESS = 0.5
_SAG, _SAG_LOADED = 0.2, 0.3
"""By how much of the horn's angle the end-effector goes further, unloaded and with 100 g; weight pulls at where it is,
so that of the stiffness sag / (1 + sag) is used up."""
_LAG_S = 0.03
"""Of the laminate; the servo's 0.017 s and the steps of the loop come on top, 0.05 s in all."""
_ASIDE_RAD = math.radians(5.9)
"""How far 100 g pull it aside."""


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """Rates of the states; parameters: k, b, I, G, height h, lever l."""
    inertia = p[2] + u[2] * p[5] * p[5]
    topple = p[3] + u[2] * _G * p[4]
    aside = u[2] * _G * p[5]
    dx[0] = x[1]
    dx[1] = (p[0] * (u[0] - x[0]) - p[1] * x[1] + topple * math.sin(x[0]) + aside * u[3] + force[0]) / inertia
    dx[2] = x[3]
    dx[3] = (p[0] * (u[1] - x[2]) - p[1] * x[3] + topple * math.sin(x[2]) - aside * u[4] + force[1]) / inertia


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Angles of both axes, rad."""
    y[0] = x[0]
    y[1] = x[2]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """For each axis: how far the laminate is bent, the axis' rate, load (none), stiffness."""
    for axis in range(2):
        values[4 * axis] = x[2 * axis] - u[axis]
        values[4 * axis + 1] = x[2 * axis + 1]
        values[4 * axis + 2] = 0.0
        values[4 * axis + 3] = p[0]


def loaded_model() -> Model:
    """Return the model.

    Stiffness and inertia are chosen, the others such that the end-effector shows what a prototype without dynamics
    assumed: it stays 0.05 s behind its command (``b / k`` of it in the laminate), goes 0.2 times its angle too far by
    its own weight and 0.3 times with 100 g on it, and is then pulled aside by 5.9 deg. The source gives none of these.
    """
    used, used_loaded = (sag / (1.0 + sag) for sag in (_SAG, _SAG_LOADED))
    per_newton = _STIFFNESS / (0.1 * _G)
    return Model(
        name="spm-load",
        states=STATES,
        inputs=tuple(
            Input(name, unit) for name, unit in zip(INPUTS, ("rad", "rad", "kg", "1", "1"), strict=True)
        ),
        outputs=tuple(Output(name, "rad") for name in OUTPUTS),
        parameters=(
            Parameter("stiffness", _STIFFNESS, unit="N m/rad", lower=1e-3),
            Parameter("damping", _LAG_S * _STIFFNESS, unit="N m s/rad", lower=0.0),
            Parameter("inertia", 2e-4, unit="kg m^2", lower=1e-7),
            Parameter("gravity_torque", _STIFFNESS * used, unit="N m"),
            Parameter("load_height", per_newton * (used_loaded - used), unit="m"),
            Parameter("load_lever", per_newton * _ASIDE_RAD * (1.0 - used_loaded), unit="m", lower=0.0),
        ),
        sites=tuple(
            Site(
                f"axis_{n}", "joint", coordinate=f"bending_{n}", rate=f"theta_{n}_rate", stiffness="stiffness"
            )
            for n in (1, 2)
        ),
        initial=dict.fromkeys(STATES, 0.0),
        **natives(derivative, output, site_values),
        source="simulated mechanism under load",
    )
