"""The blades that can be put on the pectoral five-bars: three of one piece, and one of two bodies.

The source compared three attachments and a fin of two bodies (experiment E6.a) and gives no dimensions; those here
are chosen. Each is blades that span the two outer sectors of the mechanism between two radii, cut into two rings of
blade elements; in the fin of two bodies the outer ring hangs at the inner one and follows it late.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from labrun.devices import FloatArray
from labrun_plugins.rigs.fish.five_bar import ARC_RAD

RINGS = 2
AttachmentName = Literal["broad", "slender", "short", "two-body"]


@dataclass(frozen=True)
class Attachment:
    """One kind of blade.

    Attributes
    ----------
    inner_m, outer_m
        Distance of its edges from the mechanism's centre.
    outer_lag_s
        How late the outer ring follows the inner one; 0 for a blade of one piece.
    """

    inner_m: float
    outer_m: float
    outer_lag_s: float = 0.0

    @cached_property
    def ring_m(self) -> FloatArray:
        """Distance of the blade elements from the mechanism's centre, shape (RINGS,)."""
        edges = self._edges()
        return 2.0 / 3.0 * (edges[1:] ** 3 - edges[:-1] ** 3) / (edges[1:] ** 2 - edges[:-1] ** 2)

    @cached_property
    def ring_m2(self) -> FloatArray:
        """Area of a blade element, half a sector of each ring, shape (RINGS,)."""
        edges = self._edges()
        return 0.5 * (ARC_RAD / 2.0) * (edges[1:] ** 2 - edges[:-1] ** 2)

    @cached_property
    def area_m2(self) -> float:
        """Area of one fin."""
        return float(4 * self.ring_m2.sum())

    def _edges(self) -> FloatArray:
        return np.linspace(self.inner_m, self.outer_m, RINGS + 1)


ATTACHMENTS: dict[str, Attachment] = {
    "broad": Attachment(0.08, 0.1048),
    "slender": Attachment(0.098, 0.1048),
    "short": Attachment(0.06, 0.085),
    "two-body": Attachment(0.08, 0.1048, outer_lag_s=0.06),
}
