"""A force that follows a given course in time, straight between its knots."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

import functools
from collections.abc import Sequence

from labrun.effects import AttachedEffect, Effect, EffectParameter, force_law
from labrun.models import Pointer, Site, SiteKind


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return the force at time `t`: `values` holds the first knot's time, the knots' distance, their number, forces."""
    last = int(values[2]) - 1
    place = (t - values[0]) / values[1]
    if place <= 0.0:
        return values[3]
    if place >= last:
        return values[3 + last]
    knot = int(place)
    part = place - knot
    return (1.0 - part) * values[3 + knot] + part * values[4 + knot]


def profile(site: Site, begin_s: float, step_s: float, forces: Sequence[float]) -> AttachedEffect:
    """Return the effect of forces at evenly spaced knots (linear B-splines), held beyond both ends."""
    return AttachedEffect(
        _effect(site.kind, len(forces)), site.name, (begin_s, step_s, float(len(forces)), *map(float, forces))
    )


@functools.cache
def _effect(kind: SiteKind, count: int) -> Effect:
    names = ["begin", "step", "count", *(f"force_{knot}" for knot in range(count))]
    return Effect(
        "force-profile",
        kind,
        tuple(EffectParameter(name, "force", None, float("-inf"), float("inf"), (0.0,)) for name in names),
        force_law(law),
        "F = F(t)",
        "of the diagnosis itself",
    )
