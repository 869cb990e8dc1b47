"""A curved beam under a pusher: three straight pieces of torque over angle, as the source fits its bench (section 7).

Bent against its curvature (opposite sense, positive angle) a curved beam is stiff up to a high limit; bent with it
(equal sense, negative angle) it buckles early, and what it carries hardly grows from there on: one-sided buckling.
Functions of the model signature ``(t, x, u, p, force, out)``; see `labrun.models`.
"""

from typing import Any, Literal

from labrun.models import Input, Model, Output, Parameter, Site, kernel, native

Beam = Literal["long", "short", "polyester", "steel"]

LAG_S = 0.02
"""Of load cell and amplifier behind the pusher (chosen): nothing against ramps of many seconds."""
DAMPING_N_M_S = 0.02
"""Chosen: at 1 mm/s on a lever of 100 mm it makes 2 mN."""
BUCKLED_SHARE = 0.05
"""Stiffness of the buckled beam, as a share of its stiffness before (chosen; the source's values are in a figure)."""
LIMITS_N_M: dict[Beam, tuple[float, float]] = {
    "long": (0.10, 0.76), "short": (0.65, 1.02), "polyester": (0.10, 0.76), "steel": (0.15, 0.90),
}  # fmt: skip
"""Torque at which each beam buckles in equal and in opposite sense. Of long and short the source measured it (section
7.5.1); polyester and steel tape it shows in a picture only (section 7.2): chosen."""
STIFFNESS_N_M: dict[Beam, float] = {"long": 2.0, "short": 3.0, "polyester": 2.0, "steel": 3.0}
"""Before buckling, N m/rad (chosen: the limits are then reached at 3 and 22 degrees, and at 12 and 19)."""
HYSTERESIS: dict[Beam, float] = {"long": 0.03, "short": 0.03, "polyester": 0.03, "steel": 0.12}
"""Half the width of the loop, as a share of the limit in equal sense (chosen: steel deforms plastically, and its loop
is the larger one in the source, section 7.2.1)."""


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """State: angle (rad), which follows the pusher. Inputs: displacement of the pusher (m), and see `_torque`."""
    dx[0] = (u[0] / p[6] - x[0]) / p[5]


@kernel
def _torque(angle: float, u: Any, p: Any) -> float:
    """Return the beam's torque, N m.

    Straight up to a limit in either sense, and softer beyond; both limits are `u[1]` times what they were when the beam
    was new. A beam that has snapped in opposite sense (`u[2]` is the share of the limit that it then carries, else 1)
    goes on from there, and back on the same line until it meets the straight one.
    """
    equal, opposite = u[1] * p[1], u[1] * p[2]
    straight = min(max(angle, -equal / p[0]), opposite / p[0])
    torque = p[0] * straight + p[3] * (angle - straight)
    if u[2] < 1.0:
        torque = min(p[0] * angle, u[2] * opposite + p[3] * (angle - opposite / p[0]))
    return float(torque)


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Output: force of the pusher on the beam (N), positive for the opposite sense."""
    rate = (u[0] / p[6] - x[0]) / p[5]
    y[0] = (_torque(x[0], u, p) + p[4] * rate - force[0]) / p[6]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Site ``beam``: angle, rate, load (its torque), stiffness before buckling."""
    values[0] = x[0]
    values[1] = (u[0] / p[6] - x[0]) / p[5]
    values[2] = _torque(x[0], u, p)
    values[3] = p[0]


def beam_model(beam: Beam, lever_m: float) -> Model:
    """Return the model of one of the source's beams.

    Parameters
    ----------
    beam
        "long" (31.75 mm) or "short" (3.6 mm) of section 7.5.1: 25.4 mm wide, curved by 180 degrees; "polyester" or
        "steel" of section 7.2.
    lever_m
        From where the beam is clamped to where the pusher touches the arm on it, m.
    """
    stiffness, (equal, opposite) = STIFFNESS_N_M[beam], LIMITS_N_M[beam]
    return Model(
        name="beam-bench",
        states=("angle",),
        inputs=(Input("displacement", "m"), Input("limits_left"), Input("snapped_share")),
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
