"""A curved beam under a pusher: three straight pieces of torque over angle, as the source fits its bench (section 7).

Bent against its curvature (opposite sense, positive angle) a curved beam is stiff up to a high limit; bent with it
(equal sense, negative angle) it buckles early, and what it carries hardly grows from there on: one-sided buckling.
Functions of the model signature ``(t, x, u, p, force, out)``; see `labrun.models`.
"""

from typing import Any, Literal

from labrun.models import Input, Model, Output, Parameter, Site, native

Beam = Literal["long", "short"]

LAG_S = 0.02
"""Of load cell and amplifier behind the pusher (chosen): nothing against ramps of many seconds."""
DAMPING_N_M_S = 0.02
"""Chosen: at 1 mm/s on a lever of 100 mm it makes 2 mN."""
BUCKLED_SHARE = 0.05
"""Stiffness of the buckled beam, as a share of its stiffness before (chosen; the source's values are in a figure)."""
LIMITS_N_M: dict[Beam, tuple[float, float]] = {"long": (0.10, 0.76), "short": (0.65, 1.02)}
"""Torque at which each beam buckles in equal and in opposite sense, measured by the source (section 7.5.1)."""
STIFFNESS_N_M: dict[Beam, float] = {"long": 2.0, "short": 3.0}
"""Before buckling, N m/rad (chosen: the limits are then reached at 3 and 22 degrees, and at 12 and 19)."""


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """State: angle (rad), which follows the pusher. Input: displacement of the pusher (m)."""
    dx[0] = (u[0] / p[6] - x[0]) / p[5]


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Output: force of the pusher on the beam (N), positive for the opposite sense.

    Torque is `stiffness` times the angle between the limits, and grows with `buckled_stiffness` beyond them.
    """
    rate = (u[0] / p[6] - x[0]) / p[5]
    straight = min(max(x[0], -p[1] / p[0]), p[2] / p[0])
    y[0] = (p[0] * straight + p[3] * (x[0] - straight) + p[4] * rate - force[0]) / p[6]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Site ``beam``: angle, rate, load (its torque), stiffness before buckling."""
    values[0] = x[0]
    values[1] = (u[0] / p[6] - x[0]) / p[5]
    straight = min(max(x[0], -p[1] / p[0]), p[2] / p[0])
    values[2] = p[0] * straight + p[3] * (x[0] - straight)
    values[3] = p[0]


def beam_model(beam: Beam, lever_m: float) -> Model:
    """Return the model of one of the source's beams.

    Parameters
    ----------
    beam
        "long" (31.75 mm) or "short" (3.6 mm) of section 7.5.1: 25.4 mm wide, curved by 180 degrees.
    lever_m
        From where the beam is clamped to where the pusher touches the arm on it, m.
    """
    stiffness, (equal, opposite) = STIFFNESS_N_M[beam], LIMITS_N_M[beam]
    return Model(
        name="beam-bench",
        states=("angle",),
        inputs=(Input("displacement", "m"),),
        outputs=(Output("force", "N"),),
        parameters=(
            Parameter("stiffness", stiffness, unit="N m/rad", lower=1e-3),
            Parameter("equal_limit", equal, unit="N m", lower=0.0),
            Parameter("opposite_limit", opposite, unit="N m", lower=0.0),
            Parameter("buckled_stiffness", BUCKLED_SHARE * stiffness, unit="N m/rad", lower=0.0),
            Parameter("damping", DAMPING_N_M_S, unit="N m s/rad", lower=0.0),
            Parameter("lag", LAG_S, 0.0, unit="s", lower=1e-3),
            Parameter("lever", lever_m, 0.0, unit="m", lower=1e-3),
        ),
        conditions=(),
        sites=(Site("beam", "joint", "angle", "rate", load="torque", stiffness="stiffness"),),
        initial={"angle": 0.0},
        derivative=native("model", derivative),
        output=native("model", output),
        site_values=native("model", site_values),
        source="simulated beam bench",
    )
