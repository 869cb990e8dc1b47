"""The wings of sections 7.5 and 7.6 of the source work, as values of the fin model.

What the source states: limits of the long and the short beam (section 7.5.1), stroke of 66 deg in air, fins 80 mm wide
in water. The rest is chosen: it shows its wings in pictures. Two beams side by side are taken as twice one.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from labrun.models import Input, Model, Output, Site, kernel, native, natives
from labrun_plugins.rigs.buckling_fin.equations import PARAMETERS, base_torque, fin, hinge_torque, plate_speed

Medium = Literal["water", "air"]

CONDITIONS: Mapping[Medium, tuple[str, str]] = {"water": ("beams", "wings"), "air": ("beams", "short")}
"""What a person mounts: how many beams under a wing; how many wings (mirrored, on one servo), or in air the short
beam (1) in place of the long one (0)."""

IN_AIR: Mapping[str, float] = {
    "stiffness": 0.506, "equal_limit": 0.057, "opposite_limit": 0.76, "buckled_stiffness": 0.0085, "damping": 0.003,
    "plate_mass": 0.009, "added_mass": 0.0002, "plate_area": 0.25 * math.pi * 0.145**2, "link": 0.120, "arm": 0.220,
    "density": 1.2,
}  # fmt: skip
"""A disk of 145 mm whose middle is 340 mm from the servo's axis, the hinge 120 mm from it (chosen). The limit in equal
sense is below the 0.1 N m that the source measured slowly; the first slope is that in water."""
SHORT_BEAM = (3.0, 0.65, 1.02, 0.15)
"""Stiffness, limits and buckled stiffness with the sliders 3.6 mm apart: limits of the source; slopes as of the beam
bench (chosen)."""
OF_THE_BEAM = ("stiffness", "equal_limit", "opposite_limit", "buckled_stiffness", "damping")
"""Parameters that come with the beam."""
COUPLING: Mapping[Medium, tuple[float, float]] = {"water": (60.0, 1.0), "air": (8.7, 0.57)}
"""Natural frequency (Hz) and damping ratio with which a link follows its servo's shaft (chosen): as the scenes of
``wing-water`` and ``wing-air`` have it."""
OUTPUTS = (
    Output("force_x", "N"), Output("force_y", "N"), Output("torque_z", "N m"),
    Output("link", "rad"), Output("plate", "rad"),
)  # fmt: skip
"""Load on the mount, x to the front and z up; angles of link and plate from the body's side, positive to the front."""


@kernel
def _still(x: Any) -> Any:
    """Return the states of a body that does not move, and of its left fin, as `equations` count them."""
    return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, x[0], x[1], x[2], x[3])


@kernel
def _mounted(p: Any) -> Any:
    """Return the parameters with the beams that are mounted; no distance between the servo's axis and the mount's."""
    beams, short = p[13], p[15] > 0.5 and p[14] > 0.5
    k, low, high, soft = (p[16], p[17], p[18], p[19]) if short else (p[0], p[1], p[2], p[3])
    return (
        beams * k, beams * low, beams * high, beams * soft, beams * p[4],
        p[5], p[6], p[7], p[8], p[9], p[10], p[11], p[12], 0.0, 0.0, 0.0,
    )  # fmt: skip


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """Write rates of angle and rate of the base, bend and its rate. Input: what the servo is told, rad."""
    fin_force = fin(1.0, 6, u[0], _still(x), _mounted(p), force[0], force[1])
    dx[0], dx[1] = x[1], fin_force[10]
    dx[2], dx[3] = x[3], (fin_force[6] / fin_force[14] - fin_force[9]) / p[9]


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Write outputs: see `OUTPUTS`."""
    fin_force = fin(1.0, 6, u[0], _still(x), _mounted(p), force[0], force[1])
    push, pull = fin_force[7] - fin_force[6], fin_force[14] * fin_force[8]
    two = p[15] < 0.5 and p[14] > 1.5
    y[0] = (2.0 if two else 1.0) * (push * fin_force[0] - pull * fin_force[3])
    y[1] = 0.0 if two else push * fin_force[1] - pull * fin_force[4]
    y[2] = 0.0 if two else base_torque(fin_force, (0.0, 0.0, 0.0))
    y[3], y[4] = x[0], x[0] + x[2]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Write of hinge and plate coordinate, rate, load, stiffness."""
    values[0], values[1], values[2], values[3] = x[2], x[3], hinge_torque(x[2], _mounted(p)), _mounted(p)[0]
    values[4], values[5] = (p[8] + p[9]) * x[0] + p[9] * x[2], plate_speed(x[0], x[1], x[2], x[3], 0.0, p)
    values[6] = values[7] = 0.0


def wing(medium: Medium) -> Model:
    """Return the model of a wing on its mount, or of two mirrored ones; what is mounted is its condition.

    `medium`: what it flaps in.
    """
    model = Model(
        name=f"wing-{medium}",
        states=("link", "link_rate", "bend", "bend_rate"),
        inputs=(Input("wing", "rad"),),
        outputs=OUTPUTS,
        parameters=PARAMETERS[:13],
        conditions=CONDITIONS[medium],
        sites=(
            Site("hinge", "joint", "bend", "bend_rate", load="its torque", stiffness="stiffness"),
            Site("plate", "body", "way of the plate along its normal", "speed of the plate along its normal"),
        ),
        initial=dict.fromkeys(("link", "link_rate", "bend", "bend_rate"), 0.0),
        **natives(derivative, output, site_values),
        constants=np.array([float(medium == "air"), *SHORT_BEAM]),
        source="a wing on a buckling hinge",
    )
    return model if medium == "water" else model.with_values(IN_AIR)


_derivative, _output = kernel(derivative), kernel(output)


@kernel
def _behind(p: Any) -> Any:
    """Return the parameters of a wing behind its shaft: there the link follows it in place of the servo."""
    return (
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[20], p[21], p[13], p[14], p[15],
        p[16], p[17], p[18], p[19],
    )  # fmt: skip


def told_derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:
    """Write as `derivative` does of a link that follows its shaft, and of the shaft, which follows what it is told."""
    _derivative(t, x, (x[4],), _behind(p), force, dx)
    natural = 2.0 * math.pi * p[11]
    dx[4], dx[5] = x[5], natural * natural * (u[0] - x[4]) - 2.0 * p[12] * natural * x[5]


def told_output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Write outputs: see `OUTPUTS`."""
    _output(t, x, (x[4],), _behind(p), force, y)


def told_wing(medium: Medium) -> Model:
    """Return the wing as a person at the rig would have it: told by a command, and its link on the shaft of a servo.

    ``servo_frequency`` and ``servo_damping`` are the servo's; how the link follows the shaft is the scene's.
    """
    model = wing(medium)
    return replace(
        model,
        states=(*model.states, "shaft", "shaft_rate"),
        initial={**dict.fromkeys(model.states, 0.0), "link": "wing", "shaft": "wing", "shaft_rate": 0.0},
        derivative=native("model", told_derivative),
        output=native("model", told_output),
        constants=np.append(model.constants, COUPLING[medium]),
    )


def wing_in_water() -> Model:
    """Return the wing in water."""
    return told_wing("water")


def wing_in_air() -> Model:
    """Return the wing in air."""
    return told_wing("air")
