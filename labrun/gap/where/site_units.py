"""The units of coordinate, force and load at a site, as far as the model tells them."""

from collections.abc import Sequence

from labrun.effects import unit_of
from labrun.models import Model, Site

_COORDINATE_OF_FORCE = {"N m": "rad", "N": "m"}


def force_unit(model: Model, site: Site, output_units: Sequence[str]) -> str:
    """Return the unit of a force (or torque) at a joint or body site.

    It follows from the unit of the coordinate, where that is one of the outputs, else from the unit of the site's
    stiffness ("N m/rad"). Where neither tells, a joint turns.
    """
    shown = _shown(model, site, output_units)
    if shown:
        return unit_of("force", shown)
    stiffness = next((one.unit for one in model.parameters if one.name == site.stiffness), "1")
    force, slash, _ = stiffness.rpartition("/")
    return force if slash else unit_of("force", "rad" if site.kind == "joint" else "m")


def coordinate_unit(model: Model, site: Site, output_units: Sequence[str]) -> str:
    """Return the unit of the coordinate of a site: as an output shows it, else what its force acts along."""
    shown = _shown(model, site, output_units)
    return shown or _COORDINATE_OF_FORCE.get(force_unit(model, site, output_units), "")


def load_unit(model: Model, site: Site, output_units: Sequence[str]) -> str:
    """Return the unit of the load of a site: of the output it is, else that of the force; "" where there is no load.

    The library's load-dependent friction is a pure number times the load, which therefore is a force of its kind.
    """
    if not site.load:
        return ""
    units = {one.name: unit for one, unit in zip(model.outputs, output_units, strict=True)}
    unit = units.get(site.load, "1")
    return force_unit(model, site, output_units) if unit == "1" else unit


def _shown(model: Model, site: Site, output_units: Sequence[str]) -> str:
    """Return the unit of the coordinate where an output shows it or its rate; "" where none does."""
    units = {one.name: unit for one, unit in zip(model.outputs, output_units, strict=True)}
    for name in (site.coordinate, site.rate):
        unit = units.get(name, "1").removesuffix("/s")
        if unit != "1":
            return unit
    return ""
