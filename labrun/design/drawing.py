"""The parts of a finished design, in millimetres: what the drawing to scale shows."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from labrun.spec import Condition, Design


@dataclass(frozen=True, slots=True)
class DrawnPart:
    """One part: a rectangle about a line from (`x_mm`, `y_mm`) on, turned by `angle_rad` from the x axis."""

    name: str
    x_mm: float
    y_mm: float
    length_mm: float
    width_mm: float
    angle_rad: float

    @property
    def end_mm(self) -> tuple[float, float]:
        """Where its line ends."""
        return (
            self.x_mm + self.length_mm * math.cos(self.angle_rad),
            self.y_mm + self.length_mm * math.sin(self.angle_rad),
        )

    def corners_mm(self) -> list[tuple[float, float]]:
        """Return the four corners, in order."""
        aside_x = -0.5 * self.width_mm * math.sin(self.angle_rad)
        aside_y = 0.5 * self.width_mm * math.cos(self.angle_rad)
        end_x, end_y = self.end_mm
        return [
            (self.x_mm + aside_x, self.y_mm + aside_y),
            (end_x + aside_x, end_y + aside_y),
            (end_x - aside_x, end_y - aside_y),
            (self.x_mm - aside_x, self.y_mm - aside_y),
        ]


@dataclass(frozen=True, slots=True)
class Drawing:
    """All parts, with the dimensions that are built to a tolerance.

    Attributes
    ----------
    parts
        Mirrored ones follow theirs.
    dimensions : name -> (mm or whatever the variable is in, tolerance)
    """

    parts: tuple[DrawnPart, ...]
    dimensions: Mapping[str, tuple[float, float]]

    @property
    def extent_mm(self) -> tuple[float, float, float, float]:
        """Least and greatest x, least and greatest y."""
        corners = [corner for part in self.parts for corner in part.corners_mm()]
        along, across = [x for x, _ in corners], [y for _, y in corners]
        return min(along), max(along), min(across), max(across)


def drawing_of(design: Design, values: Condition) -> Drawing | None:
    """Return the drawing of a finished design; None where the file says of no part how it looks."""
    parts = []
    for name, part in design.parts.items():
        x_mm, y_mm = (float(one(values)) for one in part.from_mm)
        angle_rad = math.radians(float(part.angle_deg(values)))
        sizes = float(part.length_mm(values)), float(part.width_mm(values))
        parts.append(DrawnPart(name, x_mm, y_mm, *sizes, angle_rad))
        if part.mirrored:
            parts.append(DrawnPart(f"{name} (mirrored)", x_mm, -y_mm, *sizes, -angle_rad))
    if not parts:
        return None
    return Drawing(
        tuple(parts),
        {name: (float(values[name]), tolerance) for name, tolerance in design.dimensions.items()},
    )
