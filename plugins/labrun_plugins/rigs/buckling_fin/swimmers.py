"""Swimmers of two fins: free along their course, on a rail or in a design's simulation, or free in the plane.

Beside the sites of `model` there is ``rail``, a joint: what a carriage's rail does to the body along x.
"""

from dataclasses import replace
from typing import Any

from labrun.effects import Site
from labrun.models import Model, Output, kernel, native
from labrun_plugins.rigs.buckling_fin import model
from labrun_plugins.rigs.buckling_fin.model import SITES, fin_model

RAIL = Site("rail", "joint", "x", "speed")


_derivative, _output, _site_values = kernel(model.derivative), kernel(model.output), kernel(model.site_values)


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:
    """Write the derivative of every state; the rail's force, behind those of `model`, is one along the body."""
    _derivative(t, x, u, p, (force[0], force[1], force[2], force[3], force[4] + force[5]), dx)


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:
    """Write outputs: see `model.OUTPUTS`."""
    _output(t, x, u, p, (force[0], force[1], force[2], force[3], force[4] + force[5]), y)


def sites_on_rail(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:
    """Write what `model.site_values` does, and of the rail coordinate and rate."""
    _site_values(t, x, u, p, force, values)
    values[20], values[21], values[22], values[23] = x[0], x[3], 0.0, 0.0


def two_fin_swimmer() -> Model:
    """Return the swimmer that moves along x only: both servos are told the same, and it stays on its course."""
    made = fin_model("two-fin-swimmer", fins=2, free=("x",))
    return replace(
        made,
        sites=(*SITES, RAIL),
        derivative=native("model", derivative),
        output=native("model", output),
        site_values=native("model", sites_on_rail),
        source="a swimmer of two fins on buckling hinges",
    )


def seen(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Write where the body is."""
    y[0] = x[0]


def swimmer_on_rail() -> Model:
    """Return the same swimmer as a person at the rig would have it: seen by cameras, the fins wherever they begin.

    The rail is taken to have no friction: what it has is to be found out.
    """
    made = two_fin_swimmer()
    begins = {"x": "first", "base_1": "free", "base_2": "free"}
    return replace(
        made,
        name="swimmer-on-rail",
        outputs=(Output("x", "m"),),
        output=native("model", seen),
        initial={**made.initial, **begins},
    )


def free_swimmer() -> Model:
    """Return the swimmer that moves in the plane: told differently left and right, it turns."""
    return fin_model("free-swimmer", fins=2, free=("x", "y", "yaw"))
