"""Candidates that are near one another: families that a person would repair in the same way, and what is common."""

from collections.abc import Mapping

from labrun.gap.diagnosis import Name

FAMILIES: Mapping[str, tuple[str, ...]] = {
    "dry friction": (
        "coulomb-friction",
        "stribeck-friction",
        "asymmetric-friction",
        "presliding-friction",
    ),
    "hysteretic friction": ("presliding-friction", "hysteresis"),
    "lost motion": ("backlash", "dead-band", "end-stop"),
    "friction under load": ("load-dependent-friction", "gear-efficiency"),
    "lateness": ("lag", "delay"),
}
"""Effects of one family, the common ones first. Presliding friction is dry friction that yields before it slips;
friction that grows with the load is not of that family, since another load shows it. A gear's efficiency is such
friction, with another share where the load drives."""

COMMON = (
    "coulomb-friction", "viscous-damping", "constant-force", "bias", "added-mass", "added-inertia", "gain-error",
    "delay", "lag", "backlash", "stribeck-friction", "load-dependent-friction", "saturation", "end-stop", "dead-band",
    "quadratic-drag", "cubic-stiffness",
)  # fmt: skip
"""How often a bench lacks it, most often first (judged, not counted): friction and offsets are everywhere, and so is
inertia that nobody drew (of a rotor, of water). What is not here comes last."""


def family(one: Name, other: Name) -> str:
    """Return the family that two effects at one site share; empty if they share none, or are the same."""
    if one == other or one.site != other.site:
        return ""
    both = {one.effect, other.effect}
    return next((name for name, members in FAMILIES.items() if both <= set(members)), "")


def rank(one: Name) -> int:
    """Return the place of an effect among what benches lack, from 0."""
    return COMMON.index(one.effect) if one.effect in COMMON else len(COMMON)
