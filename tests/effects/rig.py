"""A joint in a fluid, with everything an effect may need, and what the tests do with it."""

from labrun.effects import AttachedEffect, load_effect
from labrun.models import parse_model

JOINT = '''
name = "joint"
states = ["angle", "rate"]
inputs = ["torque", "other"]
[parameters]
inertia = 2.0
stiffness = 50.0
damping = 0.8
[equations]
angle = "rate"
rate = """(torque + 0*other + force.hinge + force.blade + force.stand + force.hand + force.arm + force.servo
  - stiffness*angle - damping*rate) / inertia"""
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
drive = true
[sites.blade]
kind = "body"
coordinate = "0.1*angle"
rate = "0.1*rate"
[sites.stand]
kind = "base"
coordinate = "5*cos(angle)"
rate = "5*sin(angle)"
[sites.hand]
kind = "tip"
coordinate = "2*sin(angle)"
rate = "2*sin(angle)"
[sites.arm]
kind = "link"
coordinate = "4*sin(2*angle)"
rate = "rate"
[sites.servo]
kind = "controller"
coordinate = "3*sin(angle)"
rate = "3*sin(angle) + 2*cos(t)"
[initial]
angle = 0.3
rate = 0.0
'''
MODEL = parse_model(JOINT, "joint.toml")
SITES = {
    "joint": "hinge",
    "body": "blade",
    "base": "stand",
    "tip": "hand",
    "link": "arm",
    "controller": "servo",
    "input": "torque",
    "output": "angle",
}


def named(id_: str, kind: str = "joint", site: str | None = None, **values: float) -> AttachedEffect:
    """Attach a shipped effect."""
    return load_effect(id_, kind).attach(site or SITES[kind], **values)
