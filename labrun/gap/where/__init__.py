"""Where a recalibrated model and the measurement differ, and the force that would close the gap."""

from labrun.gap.where.difference import Difference
from labrun.gap.where.forces import missing_forces
from labrun.gap.where.places import find_places

__all__ = ["Difference", "find_places", "missing_forces"]
