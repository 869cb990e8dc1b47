"""A force that only the diagnosis applies, to see how a model answers."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects import AttachedEffect, Effect, EffectParameter, force_law
from labrun.models import Model, Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``force``."""
    return values[0]


_FORCE = EffectParameter("force", "force", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.1,))


def push(model: Model, site: str, force: float) -> AttachedEffect:
    """Return a constant force at a joint or body site."""
    place = next(one for one in model.sites if one.name == site)
    effect = Effect("push", place.kind, (_FORCE,), force_law(law), "F = force", "of the diagnosis itself")
    return AttachedEffect(effect, site, (force,))
