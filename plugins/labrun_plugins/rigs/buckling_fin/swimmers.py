"""Swimmers of two fins: free along their course, as their design is searched, or free in the plane."""

from labrun.models import Model
from labrun_plugins.rigs.buckling_fin.model import fin_model


def two_fin_swimmer() -> Model:
    """Return the swimmer that moves along x only: both servos are told the same, and it stays on its course."""
    return fin_model("two-fin-swimmer", fins=2, free=("x",))


def free_swimmer() -> Model:
    """Return the swimmer that moves in the plane: told differently left and right, it turns."""
    return fin_model("free-swimmer", fins=2, free=("x", "y", "yaw"))
