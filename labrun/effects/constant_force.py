"""A force that never changes."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``force``."""
    return values[0]


EFFECT = Effect(
    id="constant-force",
    kind="joint",
    parameters=(EffectParameter("force", "force", neutral=0.0, lower=-1.0, upper=1.0, starts=(0.1, -0.1)),),
    function=force_law(law),
    form="F = force",
    source="offset term of the EMPS friction model: Janot, Gautier, Brunot, Nonlinear Benchmarks workshop (2019)",
)
