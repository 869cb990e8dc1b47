"""The fins of Table 5.2: which there are, how a condition names one, and how much each pushes."""

from collections.abc import Mapping

import numpy as np
from pydantic import PositiveFloat

from labrun.errors import SpecError
from labrun_plugins.simulated.bench import BenchSettings

Fin = tuple[str, float, str]
"""Material, thickness in mm, and size."""

BEST_N = 0.551
"""Mean thrust of the fin the source took, large, 1.016 mm of polyester, at 60 deg and 1.4 Hz: the tank's own gain."""
SMALL_SHARE = 0.91
"""Thrust of a small fin over that of a large one, where the table has one of them only: the mean of the two thicknesses
that it has both of is 0.913 (chosen)."""
POLYESTER_N = {
    "small": {0.254: 0.2361, 0.508: 0.2944},
    "large": {0.254: 0.2647, 0.508: 0.3154, 1.016: 0.551, 1.524: 1.157},
}
"""Table 5.2, N over thickness in mm."""
ACRYLIC_MM, ACRYLIC_N = 6.35, 0.1983
"""The acrylic tail, which was made in one size, counted as small."""


class FinSettings(BenchSettings):
    """The fin that is mounted.

    Attributes
    ----------
    material, thickness_mm, fin
        "polyester" or "acrylic", how thick, "large" or "small", see `thrust_n`; conditions of these names change it.
    """

    material: str = "polyester"
    thickness_mm: PositiveFloat = 1.016
    fin: str = "large"


def named_fin(condition: Mapping[str, float | str], mounted: Fin) -> Fin:
    """Return the fin that a condition names by ``material``, ``thickness_mm`` and ``fin``; else what is mounted."""
    material, thickness_mm, fin = mounted
    return (
        str(condition.get("material", material)),
        float(condition.get("thickness_mm", thickness_mm)),
        str(condition.get("fin", fin)),
    )


def thrust_n(material: str, thickness_mm: float, fin: str) -> float:
    """Return the mean thrust of a fin at 60 deg and 1.4 Hz, N; straight in thickness between the rows of Table 5.2.

    Raises SpecError: a fin that the table does not reach.
    """
    if fin not in POLYESTER_N:
        raise SpecError(f"this tank has no {fin!r} fin", hint="it has small and large ones")
    if material == "acrylic":
        if fin != "small" or abs(thickness_mm - ACRYLIC_MM) > 1e-9:
            raise SpecError(
                f"Table 5.2 has one acrylic tail, small and of {ACRYLIC_MM:g} mm; asked for was a {fin} one of "
                f"{thickness_mm:g} mm"
            )
        return ACRYLIC_N
    if material != "polyester":
        raise SpecError(f"this tank has no fin of {material!r}", hint="it has polyester and acrylic")
    large = POLYESTER_N["large"]
    known = dict(large)
    if fin == "small":
        known = {mm: SMALL_SHARE * force_n for mm, force_n in large.items()} | POLYESTER_N["small"]
    thicknesses = sorted(known)
    if not thicknesses[0] <= thickness_mm <= thicknesses[-1]:
        raise SpecError(
            f"a fin of {thickness_mm:g} mm is beyond Table 5.2",
            hint=f"it has {thicknesses[0]:g} to {thicknesses[-1]:g} mm of polyester",
        )
    return float(np.interp(thickness_mm, thicknesses, [known[mm] for mm in thicknesses]))
