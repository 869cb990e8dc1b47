"""The benches there are."""

from collections.abc import Callable

import numpy as np

from ..plant import Plant
from .driven import Chain, FreeDecay, HingeDrive, LinearStage, PayloadArm
from .swimming import ServoFin, StaticFin, Swimmer

PLANTS: tuple[Callable[[np.random.Generator], Plant], ...] = (
    HingeDrive, PayloadArm, FreeDecay, ServoFin, Chain, Swimmer, StaticFin, LinearStage,
)  # fmt: skip
"""Each draws one bench of its kind."""
