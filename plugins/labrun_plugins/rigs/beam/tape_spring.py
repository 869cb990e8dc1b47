"""Tape springs: torque over longitudinal curvature, and the limits at which they buckle, equations (7.1) to (7.8).

Corrected where the print needs it: (7.4) has lost its brackets, (7.6) takes the magnitude of the curvature, (7.8) is
(1 - nu) D theta, which is what (7.1) itself gives at a longitudinal curvature of -1/r and no width. Torques carry the
name of their sense, never a sign: bent against its curvature (opposite sense) the strip snaps at the maximum of (7.1);
bent with it (equal sense) it buckles at (7.8), and what (7.1) says beyond is cut off there: the twist that lets it
buckle early is not in (7.1).

Names of the literature for this theory: Wuest; Mansfield; Seffen and Pellegrino; Soykasap.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

Width = Literal["arc", "chord"]
POLYESTER_PA = 4.383e9
"""Young's modulus of polyester, section 3.1."""
_MOST_TURNS = 30.0
"""Longitudinal curvatures up to this many times 1/r are searched for the maximum; it lies below 1/r."""


@dataclass(frozen=True, slots=True)
class TapeSpring:
    """A straight strip with a curved cross-section.

    Attributes
    ----------
    arc_m
        Length of the cross-section along its curve, r theta.
    theta_rad
        Angle of the cross-section's arc.
    thickness_m, young_pa, poisson
        Of the sheet.
    width
        What stands for s in (7.1): the arc, r theta, or the chord, 2 r sin(theta/2), as (7.2) has it.
    """

    thickness_m: float
    arc_m: float = 25.4e-3
    theta_rad: float = math.pi
    young_pa: float = POLYESTER_PA
    poisson: float = 0.35
    width: Width = "arc"

    @property
    def radius_m(self) -> float:
        """Transverse radius r, m."""
        return self.arc_m / self.theta_rad

    @property
    def width_m(self) -> float:
        """The s of (7.1), m."""
        return self.arc_m if self.width == "arc" else 2.0 * self.radius_m * math.sin(0.5 * self.theta_rad)

    @property
    def rigidity_n_m(self) -> float:
        """Bending stiffness D of the sheet, N m, (7.3)."""
        return self.young_pa * self.thickness_m**3 / (12.0 * (1.0 - self.poisson**2))

    @property
    def equal_limit_n_m(self) -> float:
        """Torque at which it buckles in equal sense, N m, (7.8) corrected."""
        return (1.0 - self.poisson) * self.rigidity_n_m * self.theta_rad

    @property
    def opposite_limit_n_m(self) -> float:
        """Torque at which it snaps in opposite sense, N m: the first maximum of (7.1); nan where it has none."""
        return self.torque_n_m(self.opposite_curvature_per_m)

    @property
    def opposite_curvature_per_m(self) -> float:
        """Longitudinal curvature at that maximum, 1/m; nan where there is none."""
        curvature = np.geomspace(1e-4, _MOST_TURNS, 4000) / self.radius_m
        torque = np.array([self.torque_n_m(float(one)) for one in curvature])
        falls = np.flatnonzero(np.diff(torque) < 0)
        if not len(falls):
            return math.nan
        from scipy.optimize import minimize_scalar

        place = int(falls[0])
        low, high = float(curvature[max(place - 1, 0)]), float(curvature[place + 1])
        found = minimize_scalar(lambda one: -self.torque_n_m(one), bounds=(low, high), method="bounded")
        return float(found.x)

    def torque_n_m(self, curvature_per_m: float) -> float:
        """Return the torque at a longitudinal curvature (1/m, positive in opposite sense), N m, (7.1)."""
        if not curvature_per_m:
            return 0.0
        curved, nu, k = 1.0 / self.radius_m, self.poisson, curvature_per_m
        size = (3.0 * (1.0 - nu**2)) ** 0.25 * self.width_m / math.sqrt(self.thickness_m / abs(k))
        first, second = shape_functions(size)
        bracket = k + nu * curved - nu * (curved + nu * k) * first + (curved + nu * k) ** 2 * second / k
        return float(self.width_m * self.rigidity_n_m * bracket)


def shape_functions(size: float) -> tuple[float, float]:
    """Return F1 (7.4), its brackets put back, and F2 (7.5) of the dimensionless width (7.6).

    For a narrow strip F1 goes to 1 - size^4/180 and F2 to size^4/180; the closed forms lose all digits there.
    """
    if size < 0.3:
        return 1.0 - size**4 / 180.0, size**4 / 180.0
    # divided by cosh, which overflows for wide strips
    tanh, cosine, sine = math.tanh(size), math.cos(size), math.sin(size)
    over = 1.0 / math.cosh(size) if size < 700.0 else 0.0
    first = 2.0 / size * (1.0 - cosine * over) / (tanh + sine * over)
    return first, 0.25 * first - tanh * sine * over / (tanh + sine * over) ** 2
