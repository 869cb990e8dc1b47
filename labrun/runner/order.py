"""The order of trials: shuffled blocks, each with one repeat of every condition that still needs one."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

Order = Literal["shuffled", "as-listed"]
_STREAM = 0x0BDE
"""Sets the generator of orders apart from those of devices, which are derived from the same seed."""


def block_order(needed: Sequence[int], order: Order, *, seed: int, trial_index: int) -> list[int]:
    """Return the conditions of one block in the order they run.

    Parameters
    ----------
    needed
        Positions of the conditions that need another repeat.
    order
        "shuffled", so that drift of the bench falls on all conditions alike, or "as-listed".
    seed, trial_index
        The run's seed and the index of the block's first trial: the same run always gets the same order.
    """
    positions = list(needed)
    if order == "shuffled":
        rng = np.random.default_rng(np.random.SeedSequence((seed, _STREAM, trial_index)))
        positions = [positions[i] for i in rng.permutation(len(positions))]
    return positions
