"""What every effect does to a simple rig: the pictures of effects.md, by `labrun.models.simulate` and the effects.

A joint effect sits at the hinge of a pendulum that is driven and then left to itself, one of gear or drive at a joint
with a position servo, as effects of a robot's base, tip, links and controllers do; a body effect at a body that is
pushed to and fro through still water; an input or output effect at a signal with slow, fast and sudden parts.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from PIL import Image

from labrun.effects import AttachedEffect, Effect, Scale
from labrun.models import FloatArray, Model, parse_model, simulate, site_course
from labrun.report.style import COLOURS, SOFT, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_PENDULUM = """
name   = "driven-pendulum"
states = ["angle", "rate"]
[inputs]
torque = { unit = "N m" }
[parameters]
inertia        = { value = 0.01, unit = "kg m^2" }
stiffness      = { value = 0.3,  unit = "N m/rad" }
damping        = { value = 0.006, unit = "N m s/rad" }
gravity_torque = { value = 0.1,  unit = "N m" }
[equations]
angle = "rate"
rate  = "(force.hinge + torque - stiffness*angle - damping*rate - gravity_torque*sin(angle))/inertia"
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.hinge]
kind       = "joint"
coordinate = "angle"
rate       = "rate"
stiffness  = "stiffness"
load       = "gravity_torque*cos(angle)"
[initial]
angle = 0.0
rate  = 0.0
"""
_SERVO = """
name   = "servo-joint"
states = ["angle", "rate"]
[inputs]
goal = { unit = "rad" }
[parameters]
inertia        = { value = 0.01, unit = "kg m^2" }
kp             = { value = 0.8,  unit = "N m/rad" }
kv             = { value = 0.04,  unit = "N m s/rad" }
gravity_torque = { value = 0.3,  unit = "N m" }
[equations]
angle = "rate"
rate  = '''(force.joint + force.base + force.tip + force.link + force.controller + kp*(goal - angle) - kv*rate
  - gravity_torque*sin(angle))/inertia'''
[outputs]
angle = { equation = "angle", unit = "rad" }
[sites.joint]
kind       = "joint"
coordinate = "angle"
rate       = "rate"
load       = "kp*(goal - angle) - kv*rate"
drive      = true
[sites.base]
kind       = "base"
coordinate = "gravity_torque*cos(angle)"
rate       = "gravity_torque*sin(angle)"
[sites.tip]
kind       = "tip"
coordinate = "1.5*sin(angle)"
rate       = "1.5*sin(angle)"
[sites.link]
kind       = "link"
coordinate = "gravity_torque^2*sin(angle)*cos(angle)"
rate       = "rate"
unit       = "rad"
[sites.controller]
kind       = "controller"
coordinate = "gravity_torque*sin(angle)"
rate       = "gravity_torque*sin(goal)"
[initial]
angle = 0.0
rate  = 0.0
"""
_BODY = """
name   = "pushed-body"
states = ["position", "speed"]
[inputs]
thrust = { unit = "N" }
[parameters]
mass = { value = 2.0, unit = "kg" }
drag = { value = 8.0, unit = "N s^2/m^2" }
[equations]
position = "speed"
speed    = "(force.hull + thrust - drag*abs(speed)*speed)/mass"
[outputs]
speed = { equation = "speed", unit = "m/s" }
[sites.hull]
kind       = "body"
coordinate = "position"
rate       = "speed"
[initial]
position = 0.0
speed    = 0.0
"""
_SIGNAL = """
name   = "signal"
states = []
inputs = ["u", "other"]
[outputs]
signal = { equation = "u" }
second = { equation = "other" }
"""
_DPI = 140
_TINTS = 48
_SMALLER = 0.4
"""The second size of an effect that starts at one, in units of the first."""
_LARGEST = 3.0
"""The second size is at most so many times the first."""


@dataclass(frozen=True)
class Rig:
    """A model, what drives it, where effects sit, and what is typical there."""

    model: Model
    time_s: FloatArray
    inputs: FloatArray
    site: str
    scale: Scale


@dataclass(frozen=True)
class Signature:
    """The rig's output without the effect, and with two sizes of it. All arrays (samples,)."""

    rig: Rig
    bare: FloatArray
    sizes: tuple[AttachedEffect, AttachedEffect]
    outputs: tuple[FloatArray, FloatArray]


def signature(effect: Effect) -> Signature:
    """Return what an effect does to the rig of its kind, at the first of its starts and towards the last of them."""
    driven = "drive" in effect.needs
    rig = rig_for("servo" if driven else effect.kind)
    if effect.kind in ("base", "tip", "link", "controller"):
        rig = replace(rig_for("servo"), site=effect.kind)
    sizes = _at(effect, rig, 0), _at(effect, rig, -1)
    bare, first, second = (_output(rig, attached) for attached in ((), sizes[:1], sizes[1:]))
    return Signature(rig, bare, sizes, (first, second))


@cache
def rig_for(kind: str) -> Rig:
    """Return the rig for a kind of site, with the scale that a diagnosis would find there."""
    if kind == "joint":
        time_s = np.linspace(0.0, 8.0, 401)
        torque = 0.1 * np.sin(2 * np.pi * 0.8 * time_s) * (time_s < 5.0)
        return _scaled(
            parse_model(_PENDULUM, "pendulum.toml"),
            time_s,
            torque[:, None],
            "hinge",
            force=0.4,
            period_s=1.25,
        )
    if kind in ("servo", "base", "tip", "link", "controller"):
        time_s = np.linspace(0.0, 8.0, 401)
        goal = 0.6 * np.sin(2 * np.pi * 0.8 * time_s) * (time_s < 5.0)
        servo = parse_model(_SERVO, "servo.toml")
        return _scaled(servo, time_s, goal[:, None], "joint", force=0.8, period_s=1.25)
    if kind == "body":
        time_s = np.linspace(0.0, 8.0, 401)
        thrust = (0.5 + 2.0 * np.sin(2 * np.pi * 0.4 * time_s)) * (time_s < 5.0)
        return _scaled(
            parse_model(_BODY, "body.toml"), time_s, thrust[:, None], "hull", force=None, period_s=2.5
        )
    time_s = np.linspace(0.0, 4.0, 401)
    slow = np.sin(2 * np.pi * time_s) * (time_s < 2.0)
    steps = 0.8 * ((time_s >= 2.3) & (time_s < 2.9)) - 0.8 * ((time_s >= 2.9) & (time_s < 3.5))
    other = np.sin(2 * np.pi * 3.0 * time_s) * (time_s >= 1.0)
    site = "u" if kind == "input" else "signal"
    inputs = np.column_stack([slow + steps, other])
    return Rig(parse_model(_SIGNAL, "signal.toml"), time_s, inputs, site, Scale(signal=1.0, time_s=1.0))


def picture(effect: Effect) -> bytes:
    """Return the picture as PNG: the output without and with the effect, and below it what the effect changes."""
    result = signature(effect)
    (channel, *_), time_s = result.rig.model.outputs, result.rig.time_s
    unit = f", {channel.unit}" if channel.unit not in ("", "1") else ""
    with new_figure(6.6, 2.5) as figure:
        above, below = figure.subplots(2, 1, sharex=True, height_ratios=[1.7, 1.0])
        above.plot(time_s, result.bare, color=SOFT, linewidth=2.2, label="without")
        for size, output, colour in zip(result.sizes, result.outputs, COLOURS, strict=False):
            above.plot(time_s, output, color=colour, linewidth=1.1, label=_label(size, result.rig.model))
            below.plot(time_s, output - result.bare, color=colour, linewidth=1.1)
        below.axhline(0.0, color=SOFT, linewidth=0.8, zorder=0)
        above.set_ylabel(f"{channel.name}{unit}")
        below.set_ylabel("change")
        below.set_xlabel("time, s")
        above.set_xlim(time_s[0], time_s[-1])
        figure.align_ylabels()
        figure.legend(loc="outside upper left", ncols=1 if _long(result) else 3, handlelength=1.5)
        return _as_png(figure)


def write_pictures(effects: Mapping[str, Effect], folder: Path) -> None:
    """Write a picture for every effect, by the name of its file, and remove those of effects that are gone."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob("*.png"):
        if old.name not in effects:
            old.unlink()
    for name, effect in effects.items():
        (folder / name).write_bytes(picture(effect))


def _at(effect: Effect, rig: Rig, which: int) -> AttachedEffect:
    """Put an effect on the rig; only what can vanish changes with the size, its shape stays."""
    values = {}
    sizes = [parameter for parameter in effect.parameters if parameter.neutral is not None]
    alone = max((len(size.starts) for size in sizes), default=0) == 1
    for parameter in effect.parameters:
        starts = parameter.start_values(rig.scale)
        starts = (starts[0], _SMALLER * starts[0]) if alone and parameter in sizes else starts
        most = _LARGEST * abs(
            starts[0]
        )  # friction above what drives the rig would only show that it stands still
        # the last of three starts of a level is out of reach: a stop there shows nothing
        reached = starts[:2] if parameter.neutral in (np.inf, -np.inf) else starts
        values[parameter.name] = (
            starts[0] if parameter.neutral is None else min(max(reached[which], -most), most)
        )
    return effect.attach(rig.site, rig.scale, **values)


def _output(rig: Rig, effects: tuple[AttachedEffect, ...]) -> FloatArray:
    result = simulate(rig.model, rig.time_s, rig.inputs, effects=effects, substeps=8)
    if not result.finite:
        raise ValueError(
            f"{rig.model.name} blows up with {', '.join(effect.effect.id for effect in effects)}"
        )
    return result.outputs[:, 0]


def _scaled(
    model: Model, time_s: FloatArray, inputs: FloatArray, site: str, *, force: float | None, period_s: float
) -> Rig:
    """Return a rig whose scale is its own motion; `force` is per unit of the coordinate, else what drives it."""
    states = simulate(model, time_s, inputs, substeps=8).states
    course = site_course(model, time_s, states, inputs)[:, 0]
    excursion, rate = np.abs(course[:, 0]).max(), np.abs(course[:, 1]).max()
    acceleration = np.abs(np.gradient(course[:, 1], time_s)).max()
    typical = force * excursion if force is not None else np.abs(inputs).max()
    scale = Scale(
        float(excursion),
        float(rate),
        float(acceleration),
        float(typical),
        time_s=period_s,
        travel=float(excursion),
    )
    return Rig(model, time_s, inputs, site, scale)


def _label(effect: AttachedEffect, model: Model) -> str:
    unit = "m" if model.name == "pushed-body" else "rad"
    shown = [p for p in effect.effect.parameters if not p.held]
    parts = []
    for parameter in shown:
        of = parameter.unit(unit).replace("^2", "\u00b2").replace("^3", "\u00b3")
        value = f"{effect.named_values[parameter.name]:.2g}".replace("-", "\N{MINUS SIGN}")
        parts.append(f"{parameter.name.replace('_', ' ')} {value}{'' if of == '1' else f' {of}'}")
    return ", ".join(parts)


def _long(result: Signature) -> bool:
    return len(_label(result.sizes[0], result.rig.model)) > 34


def _as_png(figure: "Figure") -> bytes:
    """Return the figure as PNG of few colours, which is a third of the size."""
    drawn, small = BytesIO(), BytesIO()
    figure.savefig(drawn, format="png", dpi=_DPI)
    drawn.seek(0)
    Image.open(drawn).convert("RGB").quantize(_TINTS, dither=Image.Dither.NONE).save(
        small, "png", optimize=True
    )
    return small.getvalue()
