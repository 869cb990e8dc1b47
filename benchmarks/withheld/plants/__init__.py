"""The benches there are."""

from collections.abc import Callable

import numpy as np

from withheld.plant import Plant
from withheld.plants.driven import HingeDrive, LinearStage, PayloadArm
from withheld.plants.swimming import ServoFin, StaticFin, Swimmer
from withheld.plants.swinging import Chain, FreeDecay

PLANTS: tuple[Callable[[np.random.Generator], Plant], ...] = (
    HingeDrive, PayloadArm, FreeDecay, ServoFin, Chain, Swimmer, StaticFin, LinearStage,
)  # fmt: skip
"""Each draws one bench of its kind."""
