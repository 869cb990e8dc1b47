"""A joint in a fluid, with everything an effect may need, and what the tests do with it."""

from labrun.effects import AttachedEffect, Effect, EffectParameter, force_law, load_effect, signal_filter
from labrun.models import parse_model

JOINT = """
name = "joint"
states = ["angle", "rate"]
inputs = ["torque", "other"]
[parameters]
inertia = 2.0
stiffness = 50.0
damping = 0.8
[equations]
angle = "rate"
rate  = "(torque + 0*other + force.hinge + force.blade - stiffness*angle - damping*rate) / inertia"
[outputs]
angle = "angle"
rate  = "rate"
drive = "torque"
[sites.hinge]
kind = "joint"
coordinate = "angle"
rate = "rate"
stiffness = "stiffness"
load = "3*cos(angle)"
[sites.blade]
kind = "body"
coordinate = "0.1*angle"
rate = "0.1*rate"
[initial]
angle = 0.3
rate = 0.0
"""
MODEL = parse_model(JOINT, "joint.toml")
FILES = (
    "added_inertia", "added_mass", "asymmetric_friction", "asymmetric_stiffness", "backlash", "bias",
    "constant_force", "coulomb_friction", "cross_talk", "cubic_stiffness", "dead_band",
    "delay", "drag_error", "drift", "end_stop", "gain_error",
    "hysteresis", "lag", "load_dependent_friction", "mean_current", "presliding_friction",
    "quadratic_drag", "rate_limit", "rest_offset", "reynolds_dependent_drag", "saturation",
    "stribeck_friction", "viscoelastic_creep", "viscous_damping", "wall_echo",
)  # fmt: skip


def shipped() -> list[Effect]:
    """Return all effects that ship with labrun, whatever is installed."""
    effects = []
    for file in FILES:
        for kind in ("joint", "body", "input", "output"):
            try:
                effects.append(load_effect(f"labrun.effects.{file}:EFFECT", kind))
            except Exception as error:
                assert "sits at" in str(error)
    return effects


SITES = {"joint": "hinge", "body": "blade", "input": "torque", "output": "angle"}


def named(id_: str, kind: str = "joint", site: str | None = None, **values: float) -> AttachedEffect:
    """Attach a shipped effect."""
    effect = load_effect(f"labrun.effects.{id_.replace('-', '_')}:EFFECT", kind)
    return effect.attach(site or SITES[kind], **values)


__all__ = [
    "FILES",
    "JOINT",
    "MODEL",
    "SITES",
    "Effect",
    "EffectParameter",
    "force_law",
    "named",
    "shipped",
    "signal_filter",
]
