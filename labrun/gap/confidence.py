"""How sure a cause is: a probability calibrated on cases whose answer is known."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from labrun.gap.engine import Search
    from labrun.gap.noise import Basis
    from labrun.gap.rating import Rated


_SURE = 0.95
"""How often a cause far beyond chance, or its first rival, was the right one: 66 of 70 (seeds 6000 and 8000, which are
for development since)."""
_WITHOUT_REPEATS = 0.87
"""The same where noise is not told by repeats: of the causes that `labrun gap check` announced with seeds 5000, 6000,
7000 and 8000, 27 of 31 were right in cases of one repeat, 94 of 103 in those of three or five."""
_ONE_CONDITION = 0.84
"""The same where nothing can be withheld: one condition of each of those 240 recordings, diagnosed by itself, announced
128 causes, of which 107 were right."""


def confidence(search: "Search", one: "Rated") -> float:
    """Return the probability that a chosen cause, or the first of its rivals, is the right one.

    Their weight among all that explains the data as well, less what even a cause without rivals turned out to be wrong.
    """
    place = search.selection.chosen.index(one)
    rivals = search.selection.rivals[place]
    weight = search.selection.weights[place] + (rivals[0][1] if rivals else 0.0)
    beyond_chance = 1.0 - np.exp(-max(one.evidence - 0.8, 0.05))
    most = ceiling(search.noise.basis, len(search.units.conditions))
    return float(np.clip(most * weight * beyond_chance, 0.02, most))


def ceiling(basis: "Basis", conditions: int) -> float:
    """Return how sure a diagnosis may be of a cause at most: noise not told by repeats, or nothing withheld, costs."""
    return min(
        _SURE,
        _WITHOUT_REPEATS if basis == "residual" else _SURE,
        _ONE_CONDITION if conditions == 1 else _SURE,
    )
