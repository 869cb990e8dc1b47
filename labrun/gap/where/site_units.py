"""The unit of the force at a site, as far as the model tells it."""

from collections.abc import Sequence

from labrun.effects.quantities import unit_of
from labrun.models import Model, Site


def force_unit(model: Model, site: Site, output_units: Sequence[str]) -> str:
    """Return the unit of a force (or torque) at a joint or body site.

    It follows from the unit of the coordinate, where that is one of the outputs, else from the unit of the site's
    stiffness ("N m/rad"). Where neither tells, a joint turns.
    """
    units = {one.name: unit for one, unit in zip(model.outputs, output_units, strict=True)}
    for name in (site.coordinate, site.rate):
        unit = units.get(name, "1").removesuffix("/s")
        if unit != "1":
            return unit_of("force", unit)
    stiffness = next((one.unit for one in model.parameters if one.name == site.stiffness), "1")
    force, slash, _ = stiffness.rpartition("/")
    return force if slash else unit_of("force", "rad" if site.kind == "joint" else "m")
