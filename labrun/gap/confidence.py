"""How sure a cause is: a probability calibrated on cases whose answer is known."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from labrun.gap.engine import Search
    from labrun.gap.rating import Rated


_SURE = 0.97
_SURE_WITHOUT_REPEATS = 0.85
"""How often a cause without rivals and far beyond chance was the right one, on the development corpus (seed 12)."""


def confidence(search: "Search", one: "Rated") -> float:
    """Return the probability that a chosen cause, and none of its rivals, is the right one.

    Its weight among what explains the data as well, less what even a cause without rivals turned out to be wrong.
    """
    place = search.selection.chosen.index(one)
    weight = search.selection.weights[place]
    beyond_chance = 1.0 - np.exp(-max(one.evidence - 0.8, 0.05))
    sure = _SURE if search.noise.basis == "repeats" else _SURE_WITHOUT_REPEATS
    return float(np.clip(sure * weight * beyond_chance, 0.02, _SURE))
