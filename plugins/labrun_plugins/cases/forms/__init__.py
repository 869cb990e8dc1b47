"""Physics to hide, in forms that differ from the library's, by the library's ids; and physics it does not have."""

from collections.abc import Callable

import numpy as np

from ..plant import Kind, Measures, Mechanism
from .forces import BODY, DRY_FRICTION, JOINT
from .signals import INPUT, OUTPUT, OUTSIDE, OUTSIDE_SIGNALS

Maker = Callable[[str, Measures, np.random.Generator], Mechanism]

FORMS: dict[tuple[Kind, str], Maker] = {
    **{("joint", name): maker for name, maker in (DRY_FRICTION | JOINT).items()},
    **{("body", name): maker for name, maker in BODY.items()},
    **{("input", name): maker for name, maker in INPUT.items()},
    **{("output", name): maker for name, maker in OUTPUT.items()},
}

__all__ = ["FORMS", "OUTSIDE", "OUTSIDE_SIGNALS", "Maker"]
