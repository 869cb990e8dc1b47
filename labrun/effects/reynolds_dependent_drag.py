"""Drag that grows more slowly than the square of speed."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-coefficient * reference^exponent * |rate|^(2 - exponent)`` against the motion."""
    speed = abs(rate)
    if speed == 0.0:
        return 0.0
    drag: float = values[0] * speed * rate * (values[2] / speed) ** values[1]
    return -drag


EFFECT = Effect(
    id="reynolds-dependent-drag",
    kind="body",
    parameters=(
        EffectParameter("coefficient", "drag", neutral=0.0, lower=-1.0, upper=2.0, starts=(0.1, -0.1)),
        EffectParameter("exponent", "ratio", neutral=None, lower=0.1, upper=1.5, starts=(1.0, 0.5)),
        EffectParameter("reference", "rate", neutral=None, lower=1e-3, upper=10.0, starts=(1.0,), held=True),
    ),
    function=force_law(law),
    form="F = -coefficient |rate| rate (reference / |rate|)^exponent: the drag coefficient falls with Re^-exponent",
    contains=("drag-error", "quadratic-drag"),
    source="Schlichting and Gersten, Boundary-Layer Theory (2000): creeping flow Re^-1, laminar layer Re^-1/2",
)
