"""How far a hinge may turn before its sheet yields: (3.2) to (3.4) of the source work, as printed and corrected.

Printed: ``F = sigma b t^3 / (6 L)``, ``delta = F x^2 l / (2 E I)``, ``phi = F x l / (E I)``, ``I = b t^3 / 12``. The
first is no force (t^3 for t^2), and the other two are those of a pure moment M = F l, which a force at the end does not
make. With lengths in mm as bare numbers the printed set gives phi = 2 sigma x / E, and for x = 1.75 the published 1.96
degrees, too low by the factor t in mm. That real swings exceed the linear range holds all the same.
"""

import math
from typing import Literal


def printed_deg(yield_pa: float, young_pa: float, x_mm: float) -> float:
    """Return the angle as the printed equations give it, deg; `x_mm` is taken as a bare number, as the source did."""
    return math.degrees(2.0 * yield_pa * x_mm / young_pa)


def allowable_deg(
    yield_pa: float,
    young_pa: float,
    length_m: float,
    thickness_m: float,
    load: Literal["moment", "end force"] = "moment",
) -> float:
    """Return the angle at which the outer fibre of a hinge yields, deg.

    ``2 sigma l / (E t)`` where the same moment bends all of it; half of that where a force at its end does, which
    strains the clamped end most.
    """
    bent_all_along = math.degrees(2.0 * yield_pa * length_m / (young_pa * thickness_m))
    return bent_all_along if load == "moment" else 0.5 * bent_all_along
