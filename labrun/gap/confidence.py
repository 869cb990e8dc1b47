"""How sure a cause is: a probability calibrated on cases whose answer is known."""

import numpy as np

from labrun.gap import criteria
from labrun.gap.engine import Search
from labrun.gap.noise import Basis
from labrun.gap.rating import Rated


def confidence(search: Search, one: Rated) -> float:
    """Return the probability that a chosen cause, or the first of its rivals, is the right one.

    Their weight among all that explains the data as well, less what even a cause without rivals turned out to be wrong.
    """
    place = search.selection.chosen.index(one)
    rivals = search.selection.rivals[place]
    weight = search.selection.weights[place] + (rivals[0][1] if rivals else 0.0)
    beyond_chance = 1.0 - np.exp(-max(one.evidence - criteria.CHANCE_EVIDENCE, criteria.LEAST_BEYOND_CHANCE))
    most = ceiling(search.noise.basis, len(search.units.conditions))
    return float(np.clip(most * weight * beyond_chance, criteria.LEAST_CONFIDENCE, most))


def ceiling(basis: Basis, conditions: int) -> float:
    """Return how sure a diagnosis may be of a cause at most: noise not told by repeats, or nothing withheld, costs."""
    return min(
        criteria.SURE,
        criteria.SURE_WITHOUT_REPEATS if basis == "residual" else criteria.SURE,
        criteria.SURE_OF_ONE_CONDITION if conditions == 1 else criteria.SURE,
    )
