"""What would separate two causes that no trial inside the limits separates: what physics says of such pairs."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from labrun.gap.next.rivals import Rival

_LATE = {"delay", "lag"}
_OFFSET = {"constant-force", "rest-offset", "bias"}
_DRY = {"coulomb-friction", "stribeck-friction", "presliding-friction"}
_SIDED = {"asymmetric-stiffness", "constant-force"}
_MASS = {"added-inertia", "added-mass"}
_FAST = {"viscous-damping", "quadratic-drag", "drag-error", "reynolds-dependent-drag"}
_STIFF = {"cubic-stiffness", "asymmetric-stiffness", "end-stop", "backlash"}


def would_separate(one: "Rival", other: "Rival") -> str:
    """Return, as a sentence, what kind of trial or bench tells two causes apart."""
    kinds = {rival.cause.effect for rival in (one, other) if rival.cause is not None}
    if any(rival.cause is None for rival in (one, other)):
        return "More repeats, or larger motion: what is left of the gap is hardly beyond the noise."
    if kinds <= _LATE and len(kinds) == 2:
        return f"Excite faster: a delay and a lag part past 1/(2 pi tau){_corner(one, other)}."
    if "load-dependent-friction" in kinds and kinds & (_DRY | {"viscous-damping"}):
        return (
            "Load the joint differently: a second mass, in a condition that the model uses, changes friction that "
            "depends on the load and leaves the other as it is."
        )
    if kinds <= _OFFSET:
        return (
            "Change what holds the joint: at another stiffness, or turned over against gravity, a constant force moves "
            "it by another angle, a displaced rest position by the same; a second sensor tells the bias of the first."
        )
    if kinds & _SIDED and kinds & (_DRY | _SIDED | _OFFSET):
        return (
            "Measure at two orientations of gravity: what comes from the bench's tilt changes sides with it, what belongs "
            "to the joint does not."
        )
    if kinds & _MASS and kinds & (_FAST | _STIFF | _LATE):
        return "Vary the frequency at the same amplitude: inertia grows with its square, the other does not."
    if kinds & (_FAST | _STIFF) or kinds & _DRY:
        return "Vary the amplitude over a wide range, at one frequency: the two grow with different powers of it."
    return (
        "A further sensor between the two sites, or motion over a wider range of amplitude and frequency than these limits "
        "allow."
    )


def _corner(*rivals: "Rival") -> str:
    """Return the corner frequency of a lag among the rivals, as fitted."""
    for rival in rivals:
        taus: Sequence[float] = list(rival.sizes.values())
        if rival.cause is not None and rival.cause.effect == "lag" and taus and taus[0] > 0:
            return f" = {1.0 / (2.0 * math.pi * taus[0]):.3g} Hz"
    return ""
