"""Stiffness and damping of a polyester laminate hinge by its dimensions: the maps (3.6) to (3.12) of the source work.

The maps are printed without units. Lengths in m and areas in m^2 are the only ones for which their values make sense,
and stiffness (N m/rad) and damping (N m s/rad) follow from equation (3.5). Three coefficients are misprinted; with the
corrections below all seven maps agree at the nominal specimen (w = 50 mm, l = 1.75 mm, a = 43 cm^2):

- (3.8): ``+0.1361 w`` (printed: ``-``, which gives negative stiffness from 2.3 to 41.8 mm);
- (3.10): constant ``0.0251`` (printed: ``0.251``, 13 times the mean stiffness);
- (3.11): ``-0.0227 l`` (printed: ``-0.227``, negative damping everywhere).

They describe 0.127 mm polyester between about w = 10-60 mm, l = 1-5 mm, a = 2-100 cm^2. Do not extrapolate.
"""

import warnings

from labrun.errors import ModelError
from labrun_plugins.rigs.hinge.polynomial import PUBLISHED

LEAST_DAMPING = 1.61e-5
"""Minimum of (3.6), N m s/rad: the least total damping any of the single-variable maps gives."""


class HingeMapWarning(UserWarning):
    """A fitted map was asked outside of the specimens it was fitted to."""


def stiffness(width_m: float, length_m: float) -> float:
    """Return k by (3.12), N m/rad.

    Raises ModelError: the map is not positive there, as for narrow hinges longer than 1 mm.
    """
    k = PUBLISHED["stiffness", ("l", "w")].value({"w": width_m, "l": length_m})
    if k > 0:
        return k
    raise ModelError(
        f"map (3.12) gives a stiffness of {k:.3g} N m/rad for w = {width_m * 1e3:g} mm, l = {length_m * 1e3:g} mm: "
        "it does not hold there",
        hint="the maps describe hinges 10 to 60 mm wide and 1 to 5 mm long, and no narrow and long ones",
    )


def damping(area_m2: float, width_m: float, length_m: float) -> float:
    """Return b by (3.11) as corrected, N m s/rad.

    Off the lines along which the specimens were varied the polynomial can turn negative. It is then replaced by
    `LEAST_DAMPING`, with a `HingeMapWarning`.
    """
    b = PUBLISHED["damping", ("a", "l", "w")].value({"a": area_m2, "w": width_m, "l": length_m})
    if b >= LEAST_DAMPING:
        return b
    warnings.warn(
        f"map (3.11) gives a damping of {b:.3g} N m s/rad for a = {area_m2 * 1e4:g} cm^2, w = {width_m * 1e3:g} mm, "
        f"l = {length_m * 1e3:g} mm, far from the specimens it was fitted to; {LEAST_DAMPING:g} is used",
        HingeMapWarning,
        stacklevel=2,
    )
    return LEAST_DAMPING
