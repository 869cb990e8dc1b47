"""How sure a cause is: a probability calibrated on cases whose answer is known."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from labrun.gap.engine import Search
    from labrun.gap.rating import Rated


def confidence(search: "Search", one: "Rated") -> float:
    """Return the probability that a chosen cause is the right one."""
    place = search.selection.chosen.index(one)
    weight = search.selection.weights[place]
    alone = 1.0 - np.exp(-max(one.evidence - 0.8, 0.05))
    return float(np.clip(weight * alone, 0.02, 0.99))
