"""A strip between two grips: a toe where it is not yet taut, a straight part, and a softer one beyond the yield stress.

Functions of the model signature ``(t, x, u, p, force, out)``; see `labrun.models`.
"""

import math
from typing import Any

from labrun.models import Input, Model, Output, Parameter, Site, kernel, native

LAG_S = 0.02
"""Of load cell and amplifier behind the grip (chosen)."""
TOE_STRAIN = 1e-3
"""Width of the toe (chosen)."""
HARDENING_SHARE = 1.0 / 20.0
"""Slope beyond the yield stress, as a share of Young's modulus (chosen)."""
YOUNG_PA, YIELD_PA = 4383.27e6, 42.84e6
"""Means of the source's eleven specimens (section 3.1)."""
THICKNESS_M, WIDTH_M, GRIPS_M = 0.127e-3, 15e-3, 0.1
"""Of the sheet; the source gives no width and no distance of the grips: chosen."""


@kernel
def _taut(strain: float, slack: float) -> float:
    """Return the strain that the straight part sees: none before the slack is gone, over a toe."""
    place = (strain - slack) / TOE_STRAIN
    return TOE_STRAIN * (place if place > 40.0 else math.log1p(math.exp(place)))


@kernel
def _load(elongation: float, longest: float, u: Any, p: Any) -> float:
    """Return the force of the strip, N; on its way back it unloads straight from where it was longest."""
    yielded = p[1] / p[0]
    farthest = _taut(max(longest, elongation) / p[3], u[1])
    stress = p[0] * min(farthest, yielded) + p[2] * p[0] * max(farthest - yielded, 0.0)
    stress -= p[0] * (farthest - _taut(elongation / p[3], u[1]))
    return float(u[3] * p[4] * max(stress, 0.0))


def derivative(t: float, x: Any, u: Any, p: Any, force: Any, dx: Any) -> None:  # noqa: ARG001
    """State: elongation, and the longest that it was (m), which follow the grip alike: what only lags is no way back.

    Inputs: displacement of the grip (m), slack (strain), the farthest that the grip has been (m), and whether the strip
    is whole (1) or broken (0).
    """
    dx[0], dx[1] = (u[0] - x[0]) / p[5], (u[2] - x[1]) / p[5]


def output(t: float, x: Any, u: Any, p: Any, force: Any, y: Any) -> None:  # noqa: ARG001
    """Output: force (N)."""
    y[0] = _load(x[0], x[1], u, p) - u[3] * force[0]


def site_values(t: float, x: Any, u: Any, p: Any, force: Any, values: Any) -> None:  # noqa: ARG001
    """Site ``strip``: elongation (m), rate (m/s), load (N), stiffness (N/m)."""
    values[0] = x[0]
    values[1] = (u[0] - x[0]) / p[5]
    values[2] = _load(x[0], x[1], u, p)
    values[3] = p[0] * p[4] / p[3]


def strip_model(young_pa: float, yield_pa: float, hardening: float, area_m2: float, grips_m: float) -> Model:
    """Return the model of a strip of a sheet."""
    return Model(
        name="tensile-bench",
        states=("elongation", "longest"),
        inputs=(Input("displacement", "m"), Input("slack"), Input("farthest", "m"), Input("whole")),
        outputs=(Output("force", "N"),),
        parameters=(
            Parameter("young", young_pa, unit="Pa", lower=1.0),
            Parameter("yield_stress", yield_pa, unit="Pa", lower=1.0),
            Parameter("hardening", hardening, lower=0.0),
            Parameter("grips", grips_m, 0.0, unit="m", lower=1e-3),
            Parameter("area", area_m2, 0.0, unit="m^2", lower=1e-12),
            Parameter("lag", LAG_S, 0.0, unit="s", lower=1e-3),
        ),
        conditions=(),
        sites=(Site("strip", "joint", "elongation", "rate", load="load", stiffness="stiffness", unit="m"),),
        initial={"elongation": 0.0, "longest": 0.0},
        derivative=native("model", derivative),
        output=native("model", output),
        site_values=native("model", site_values),
        source="simulated tensile bench",
    )
