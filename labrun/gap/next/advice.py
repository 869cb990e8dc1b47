"""What would separate two causes that no trial inside the limits separates: what physics says of such pairs."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from labrun.gap.next.rivals import Rival

_LATE = frozenset({"delay", "lag"})
_OFFSET = frozenset({"constant-force", "rest-offset", "bias"})
_DRY = frozenset({"coulomb-friction", "stribeck-friction", "presliding-friction"})
_SIDED = frozenset({"asymmetric-friction", "asymmetric-stiffness", "constant-force"})
_TILT = frozenset({"tilt", "tilt_rad", "tilt_deg"})
"""What a model calls the parameter that says how its bench stands."""
_MASS = frozenset({"added-inertia", "added-mass"})
_FAST = frozenset({"viscous-damping", "quadratic-drag", "drag-error", "reynolds-dependent-drag"})
_STIFF = frozenset({"cubic-stiffness", "asymmetric-stiffness", "end-stop", "backlash"})

_HARDLY = "More repeats, or larger motion: what is left of the gap is hardly beyond the noise."
_OTHERWISE = (
    "A further sensor between the two, or motion over a wider range of amplitude and frequency than was "
    "allowed here."
)


@dataclass(frozen=True, slots=True)
class _Rule:
    """Advice for a pair with one effect in each of two sets."""

    one: frozenset[str]
    other: frozenset[str]
    advice: str


_RULES = (
    _Rule(
        frozenset({"delay"}),
        frozenset({"lag"}),
        "Excite faster: a delay and a lag part past 1/(2 pi tau){corner}.",
    ),
    _Rule(
        frozenset({"load-dependent-friction"}),
        _DRY | {"viscous-damping"},
        "Load the joint differently: a second mass, as a condition that the "
        "model uses, changes friction that depends on "
        "the load and leaves the other as it is.",
    ),
    _Rule(
        frozenset({"coulomb-friction"}),
        frozenset({"stribeck-friction", "presliding-friction"}),
        "The richer friction contains the simpler one, and at the sizes found "
        "they are the same: only slower motion, and "
        "reversals, could show a difference.",
    ),
    _Rule(
        frozenset({"constant-force"}),
        frozenset({"rest-offset"}),
        "A constant force and a displaced rest position are the same in a "
        "joint of one stiffness: exchange its spring, or "
        "turn it over against gravity.",
    ),
    _Rule(
        _OFFSET,
        _OFFSET,
        "Change what holds the joint (its spring, its load, its orientation to gravity): a force moves it by another "
        "angle then, a sensor's bias stays; a second sensor tells the bias of the first.",
    ),
    _Rule(
        frozenset({"asymmetric-friction"}),
        frozenset({"coulomb-friction"}),
        "The richer friction contains the simpler one, and at the sizes found they are the same: only the same course "
        "with its sign turned round, often, could show a difference.",
    ),
    _Rule(
        frozenset({"asymmetric-friction"}),
        _DRY | _FAST | frozenset({"load-dependent-friction", "hysteresis"}),
        "Drive it both ways alike, by the same course and that course with its sign turned round: what resists both "
        "directions alike gives mirror images, friction with a level for each does not.",
    ),
    _Rule(
        _SIDED,
        _DRY | _SIDED | _OFFSET | _TILT,
        "Measure at two orientations of gravity: what comes from the bench's "
        "tilt changes sides, what belongs to the joint "
        "does not.",
    ),
    _Rule(
        _MASS,
        _FAST | _STIFF | _LATE,
        "Vary the frequency at the same amplitude: inertia grows with its square, the other does not.",
    ),
    _Rule(
        _FAST | _STIFF | _DRY,
        _FAST | _STIFF | _DRY,
        "Vary the amplitude over a wide range, at one frequency: the two grow with different powers of it.",
    ),
)


def would_separate(one: "Rival", other: "Rival") -> str:
    """Return, as a sentence that names both, what kind of trial or bench tells two causes apart."""
    return f"{one.name} or {other.name}: {_advice(one, other)}"


def _advice(one: "Rival", other: "Rival") -> str:
    if one.cause is None or other.cause is None:
        return _HARDLY
    here, there = one.cause.effect, other.cause.effect
    if here == there:
        return _OTHERWISE
    for rule in _RULES:
        if (here in rule.one and there in rule.other) or (there in rule.one and here in rule.other):
            return rule.advice.format(corner=_corner(one, other))
    return _OTHERWISE


def _corner(*rivals: "Rival") -> str:
    """Return the corner frequency of a lag among the rivals, as fitted."""
    for rival in rivals:
        taus = list(rival.sizes.values())
        if rival.cause is not None and rival.cause.effect == "lag" and taus and taus[0] > 0:
            return f" = {1.0 / (2.0 * math.pi * taus[0]):.3g} Hz"
    return ""
