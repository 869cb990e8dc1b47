"""Units and typical magnitudes of an effect's parameters, which depend on the site it is put at."""

from dataclasses import dataclass
from typing import Literal

Quantity = Literal[
    "force",
    "coordinate",
    "rate",
    "damping",
    "drag",
    "stiffness",
    "cubic-stiffness",
    "inertia",
    "signal",
    "signal-rate",
    "time",
    "time-per-coordinate",
    "ratio",
]

_ROTARY = {
    "force": "N m",
    "damping": "N m s/rad",
    "drag": "N m s^2/rad^2",
    "stiffness": "N m/rad",
    "cubic-stiffness": "N m/rad^3",
    "inertia": "kg m^2",
}
_LINEAR = {
    "force": "N",
    "damping": "N s/m",
    "drag": "N s^2/m^2",
    "stiffness": "N/m",
    "cubic-stiffness": "N/m^3",
    "inertia": "kg",
}


@dataclass(frozen=True, slots=True)
class Scale:
    """Typical magnitudes at a site: peak excursion, speed, acceleration and force of the data, SI.

    The default 1 everywhere leaves an effect's numbers as they stand.
    """

    coordinate: float = 1.0
    rate: float = 1.0
    acceleration: float = 1.0
    force: float = 1.0
    signal: float = 1.0
    time_s: float = 1.0

    def of(self, quantity: Quantity) -> float:
        """Return the typical magnitude of a quantity, SI."""
        return {
            "force": self.force,
            "coordinate": self.coordinate,
            "rate": self.rate,
            "damping": self.force / self.rate,
            "drag": self.force / self.rate**2,
            "stiffness": self.force / self.coordinate,
            "cubic-stiffness": self.force / self.coordinate**3,
            "inertia": self.force / self.acceleration,
            "signal": self.signal,
            "signal-rate": self.signal / self.time_s,
            "time": self.time_s,
            "time-per-coordinate": 1.0 / self.rate,
            "ratio": 1.0,
        }[quantity]


def unit_of(quantity: Quantity, coordinate_unit: str = "rad", signal_unit: str = "1") -> str:
    """Return the unit of a quantity at a site whose coordinate (or whose signal) has that unit."""
    simple = {
        "time": "s",
        "ratio": "1",
        "signal": signal_unit,
        "signal-rate": f"{signal_unit}/s",
        "coordinate": coordinate_unit,
        "rate": f"{coordinate_unit}/s",
        "time-per-coordinate": f"s/{coordinate_unit}",
    }
    if quantity in simple:
        return simple[quantity]
    if coordinate_unit == "rad":
        return _ROTARY[quantity]
    if coordinate_unit == "m":
        return _LINEAR[quantity]
    c = coordinate_unit  # neither: the force is whatever the model's equation makes it
    other = {
        "damping": f" s/{c}",
        "drag": f" s^2/{c}^2",
        "stiffness": f"/{c}",
        "cubic-stiffness": f"/{c}^3",
        "inertia": f" s^2/{c}",
    }
    return f"force{other.get(quantity, '')}"
