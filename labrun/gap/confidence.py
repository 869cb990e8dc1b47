"""How sure a cause is: a probability calibrated on cases whose answer is known."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from labrun.gap.engine import Search
    from labrun.gap.rating import Rated


_SURE = 0.96
"""How often a cause far beyond chance, or its first rival, was the right one (development corpus, seed 12)."""


def confidence(search: "Search", one: "Rated") -> float:
    """Return the probability that a chosen cause, or the first of its rivals, is the right one.

    Their weight among all that explains the data as well, less what even a cause without rivals turned out to be wrong.
    """
    place = search.selection.chosen.index(one)
    rivals = search.selection.rivals[place]
    weight = search.selection.weights[place] + (rivals[0][1] if rivals else 0.0)
    beyond_chance = 1.0 - np.exp(-max(one.evidence - 0.8, 0.05))
    return float(np.clip(_SURE * weight * beyond_chance, 0.02, _SURE))
