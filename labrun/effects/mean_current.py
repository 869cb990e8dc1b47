"""Fluid that moves past the body by itself."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return the drag in still fluid less the drag against a current of `speed`."""
    through = rate - values[1]
    return values[0] * (abs(rate) * rate - abs(through) * through)


EFFECT = Effect(
    id="mean-current",
    kind="body",
    parameters=(
        EffectParameter("coefficient", "drag", neutral=None, lower=0.01, upper=2.0, starts=(0.3,)),
        EffectParameter("speed", "rate", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.1, -0.1)),
    ),
    function=force_law(law),
    form="F = coefficient (|rate| rate - |rate - speed| (rate - speed))",
    source="drag on the speed relative to the fluid; Morison et al., Petroleum Transactions 189 (1950) 149",
)
