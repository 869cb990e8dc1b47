"""A spring whose force depends on where it came from (Bouc-Wen)."""

# ruff: noqa: ARG001 - the signature is fixed, whatever of it a form uses

from labrun.effects.effect import Effect, EffectParameter, force_law
from labrun.models.native import Pointer


def law(
    t: float, q: float, rate: float, acceleration: float, load: float, stiffness: float,
    values: Pointer, z: Pointer, dz: Pointer,
) -> float:  # fmt: skip
    """Return ``-force * z``, with ``dz/dt = rate (1 - |z|^2 (1 + sign(rate z)) / 2) / yield_displacement``."""
    loading = 1.0 if rate * z[0] > 0.0 else 0.0
    dz[0] = rate * (1.0 - z[0] * z[0] * loading) / values[1]
    return -values[0] * z[0]


EFFECT = Effect(
    id="hysteresis",
    kind="joint",
    parameters=(
        EffectParameter("force", "force", neutral=0.0, lower=0.0, upper=2.0, starts=(0.05, 0.3)),
        EffectParameter(
            "yield_displacement", "coordinate", neutral=None, lower=0.02, upper=1.0, starts=(0.1, 0.3)
        ),
    ),
    function=force_law(law),
    form="F = -force z, dz/dt = rate (1 - |z|^2 (1 + sign(rate z)) / 2) / yield_displacement",
    contains=("coulomb-friction", "presliding-friction"),
    source="Bouc 1967; Wen, J. Engineering Mechanics 102 (1976) 249, with exponent 2 and equal shape parameters",
    states=1,
)
