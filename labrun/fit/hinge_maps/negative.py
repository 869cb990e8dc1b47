"""Where a fitted map turns negative between the specimens, which neither stiffness nor damping can."""

import itertools

import numpy as np

from labrun.fit.hinge_maps.forms import UNITS
from labrun.fit.hinge_maps.polynomial import FittedMap, FloatArray
from labrun.fit.hinge_maps.specimens import SIZES

_LINE, _BOX = 401, 25


def hub(one: FittedMap) -> dict[str, float]:
    """Return the size of every variable that most specimens share: where the lines of specimens cross."""
    found = {}
    for name, values in one.sizes.items():
        sizes, counts = np.unique(values, return_counts=True)
        found[name] = float(sizes[np.argmax(counts)])
    return found


def line(one: FittedMap, name: str, count: int = _LINE) -> dict[str, FloatArray]:
    """Return points along one size, between its smallest and its largest specimen, the others at the hub."""
    own = np.linspace(float(one.sizes[name].min()), float(one.sizes[name].max()), count)
    return {other: own if other == name else np.full(count, at) for other, at in hub(one).items()}


def negative_warnings(one: FittedMap) -> list[str]:
    """Return where along the lines of specimens the map is negative, and in how much of the box around them."""
    told = []
    for name in one.form.variables:
        points = line(one, name)
        values = one.value(points)
        below = points[name][values <= 0]
        if len(below):
            condition, factor = SIZES[name]
            unit = condition.rpartition("_")[2].replace("cm2", "cm^2")
            told.append(
                f"{one.form.label} turns negative between specimens, at {name} = {below[0] / factor:.3g} to "
                f"{below[-1] / factor:.3g} {unit} (least: {values.min():.2g} {UNITS[one.form.quantity]}): do not use "
                "it there, and measure a specimen there"
            )
    if len(one.form.variables) > 1:
        axes = [np.linspace(values.min(), values.max(), _BOX) for values in one.sizes.values()]
        grid = np.array(list(itertools.product(*axes))).T
        share = float(np.mean(one.value(dict(zip(one.sizes, grid, strict=True))) <= 0))
        if share > 0:
            told.append(
                f"{one.form.label} is negative in {100 * share:.2g} % of the box that the specimens span, off the "
                "lines along which they were varied: nothing was measured there, and the map says nothing about it"
            )
    return told
