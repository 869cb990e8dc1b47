"""Swimmers of two fins: free along their course, on a rail or in a design's simulation, or free in the plane.

Along its course a swimmer is its own mirror image: what sits at the ``hinge`` or at the ``plate`` sits at both of them.
Beside those and ``body`` there is ``rail``, a joint: what a carriage's rail does to the body along x.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np

from labrun.effects import Scale, load_effect
from labrun.models import Input, Model, Output, Parameter, Site, kernel, natives
from labrun_plugins.rigs.buckling_fin import model
from labrun_plugins.rigs.buckling_fin.equations import PARAMETERS, fin, hinge_torque, plate_speed
from labrun_plugins.rigs.buckling_fin.model import fin_model

SITES = (
    Site("hinge", "joint", "bend", "bend_rate", load="its torque", stiffness="stiffness"),
    Site("plate", "body", "way of the plate along its normal", "speed of the plate along its normal"),
    Site("body", "body", "x", "speed"),
    Site("rail", "joint", "x", "speed", unit="m"),
)
_ASIDE = (
    "motor_spacing", "body_inertia", "body_side_area", "yaw_drag", "mount_stiffness", "mount_damping",
    "yaw_stiffness", "yaw_damping",
)  # fmt: skip
"""Parameters that do nothing along the course."""
_BUILT = ("link", "arm", "plate_area", "plate_mass", "added_mass", "opposite_limit", "body_mass")
"""Those that are known of a swimmer that was built: dimensions within 0.2 mm, masses from scales; the limit in opposite
sense is never reached."""
_CARRIAGE = Parameter("carriage_mass", 0.3, 0.0, "kg", lower=0.0)
"""What of the body's mass is above the sensor (chosen)."""
LINK_HZ, LINK_DAMPING = 30.0, 1.0
"""Natural frequency and damping ratio with which a link follows its servo's shaft on the rig (chosen): how a shaft
follows its command is the servo's own, 6 Hz here."""
_FRAME_S = 0.02
"""From one command that an RC servo takes note of to the next."""
_CAMERAS_S = 0.0055
"""From the exposure of the cameras to the receipt of the frame, whose time it gets."""


_derivative, _output, _site_values = kernel(model.derivative), kernel(model.output), kernel(model.site_values)


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:
    """Write the derivative of every state of both fins and the body."""
    _derivative(t, x, u, p, (force[0], force[0], force[1], force[1], force[2] + force[3]), dx)


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:
    """Write outputs: see `model.OUTPUTS`; behind them what the rail does to the body along x."""
    _output(t, x, u, p, (force[0], force[0], force[1], force[1], force[2] + force[3]), y)
    y[18] = force[3]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Write of one hinge and one plate, of body and rail coordinate, rate, load, stiffness."""
    values[0], values[1], values[2], values[3] = x[8], x[9], hinge_torque(x[8], p), p[0]
    values[4], values[5] = (p[8] + p[9]) * x[6] + p[9] * x[8], plate_speed(x[6], x[7], x[8], x[9], x[3], p)
    values[6] = values[7] = 0.0
    for i in range(2):
        values[8 + 4 * i], values[9 + 4 * i] = x[0], x[3]
        values[10 + 4 * i] = values[11 + 4 * i] = 0.0


def two_fin_swimmer(*, held: bool = False) -> Model:
    """Return the swimmer that moves along x only, or not at all where something holds it.

    Both servos are told the same, and it stays on its course.
    """
    made = fin_model("two-fin-swimmer", fins=2, free=() if held else ("x",))
    return replace(
        made,
        outputs=(*made.outputs, Output("rail_force", "N")),
        sites=SITES,
        **natives(derivative, output, site_values),
        source="a swimmer of two fins on buckling hinges",
    )


@kernel
def _course(x: Any, p: Any, force: Any) -> Any:
    """Return what one of two equal fins does, and the accelerations of body and bend."""
    state = (x[0], 0.0, 0.0, x[1], 0.0, 0.0, x[2], x[3], x[4], x[5])
    behind = (
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], LINK_HZ, LINK_DAMPING, p[13], p[14], p[15],
    )  # fmt: skip
    fin_force = fin(1.0, 6, x[6], state, behind, force[0], force[1])
    push = 2.0 * ((fin_force[7] - fin_force[6]) * fin_force[0] - fin_force[14] * fin_force[8] * fin_force[3])
    drag = -p[10] * p[14] * x[1] * abs(x[1]) + force[2] + force[3]
    ahead = (push + drag) / (p[13] + 2.0 * fin_force[14] * fin_force[3] * fin_force[3])
    return fin_force, ahead, (fin_force[6] / fin_force[14] - fin_force[9] - fin_force[0] * ahead) / p[9]


def course(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """Write rates of the states of a swimmer that is its own mirror image."""
    lateral, ahead, bend = _course(x, p, force)
    dx[0], dx[1] = x[1], ahead
    dx[2], dx[3], dx[4], dx[5] = x[3], lateral[10], x[5], bend
    natural = 2.0 * math.pi * p[11]
    dx[6], dx[7] = x[7], natural * natural * (u[0] - x[6]) - 2.0 * p[12] * natural * x[7]


def seen(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Write where the body is, and what the swimmer does to the carriage above the sensor."""
    _, ahead, _ = _course(x, p, force)
    y[0], y[1] = x[0], p[23] * ahead - force[3]


def seen_sites(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Write what `site_values` does."""
    values[0], values[1], values[2], values[3] = x[4], x[5], hinge_torque(x[4], p), p[0]
    values[4], values[5] = (p[8] + p[9]) * x[2] + p[9] * x[4], plate_speed(x[2], x[3], x[4], x[5], x[1], p)
    values[6] = values[7] = 0.0
    for i in range(2):
        values[8 + 4 * i], values[9 + 4 * i] = x[0], x[1]
        values[10 + 4 * i] = values[11 + 4 * i] = 0.0


def swimmer_on_rail() -> Model:
    """Return the same swimmer as a person at the rig would have it: seen by cameras, on a sensor under a carriage.

    A link follows its shaft, and the shaft a servo of 6 Hz, which takes note of a command every 20 ms: on average half
    of that late. The cameras' frames get the time of their receipt. Both fins are told the same and are alike, so that
    one is computed; they begin at rest where the command does. The rail is taken to have no friction: what it has is to
    be found out.
    """
    states = ("x", "speed", "base", "base_rate", "bend", "bend_rate", "shaft", "shaft_rate")
    scale = Scale(0.5, 0.3, 3.0, 1.0, 0.5, 2.0)
    delayed = load_effect("delay", "input").attach("told", scale, delay=0.5 * _FRAME_S)
    stamped = load_effect("delay", "output").attach("x", scale, delay=_CAMERAS_S)
    made = Model(
        name="swimmer-on-rail",
        states=states,
        inputs=(Input("told", "rad"),),
        outputs=(Output("x", "m"), Output("force_x", "N")),
        parameters=(
            *(
                replace(parameter, tolerance=0.0) if parameter.name in (*_ASIDE, *_BUILT) else parameter
                for parameter in PARAMETERS
            ),
            _CARRIAGE,
        ),
        sites=SITES,
        initial={**dict.fromkeys(states, 0.0), "x": "first", "base": "told", "shaft": "told"},
        **natives(course, seen, seen_sites),
        constants=np.empty(0),
        source="a swimmer of two fins under a carriage",
    )
    return made.with_effects([delayed, stamped])


def free_swimmer() -> Model:
    """Return the swimmer that moves in the plane: told differently left and right, it turns."""
    return fin_model("free-swimmer", fins=2, free=("x", "y", "yaw"))
