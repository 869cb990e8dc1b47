"""A fitted map beside the published one: where that may be read, and how far specimens lie off it."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from labrun.fit.hinge_maps.forms import NOMINAL, PUBLISHED_RANGE
from labrun.fit.hinge_maps.polynomial import FittedMap
from labrun.fit.hinge_maps.specimens import Specimen

FloatArray = NDArray[np.float64]

_NEARLY = 0.02
"""Relative difference up to which a size counts as nominal."""
_EDGE = 1e-6


def published_at(one: FittedMap, specimens: Sequence[Specimen]) -> FloatArray:
    """Return the published map at every specimen, nan where it may not be read, shape (n,).

    It may not outside of the sizes it was fitted to, and one over a single size not for hinges or bodies that are not
    nominal otherwise.
    """
    return np.array([_value(one, specimen.sizes) for specimen in specimens])


def unread(one: FittedMap, specimens: Sequence[Specimen]) -> list[str]:
    """Return the labels of specimens at which the published map may not be read."""
    if one.form.published is None:
        return []
    return [specimen.label for specimen in specimens if not _readable(one, specimen.sizes)]


def published_mae(one: FittedMap, specimens: Sequence[Specimen]) -> float:
    """Return the mean absolute error of the published map on these specimens; nan if it may be read at none."""
    error = np.abs(one.measured - published_at(one, specimens))
    known = error[np.isfinite(error)]
    return float(np.mean(known)) if len(known) else float("nan")


def _value(one: FittedMap, sizes: Mapping[str, float]) -> float:
    if one.form.published is None or not _readable(one, sizes):
        return float("nan")
    return one.form.published.value(sizes)


def _readable(one: FittedMap, sizes: Mapping[str, float]) -> bool:
    inside = all(
        PUBLISHED_RANGE[name][0] * (1 - _EDGE) <= sizes[name] <= PUBLISHED_RANGE[name][1] * (1 + _EDGE)
        for name in one.form.variables
    )
    # k depends on the hinge only, whatever hangs on it
    others = [
        name
        for name in NOMINAL
        if name not in one.form.variables and not (name == "a" and one.form.quantity == "stiffness")
    ]
    nominal = all(abs(sizes[name] / NOMINAL[name] - 1) <= _NEARLY for name in others)
    return inside and nominal
