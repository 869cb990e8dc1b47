"""Physics to hide, in forms that differ from the library's, by the library's ids; and physics it does not have."""

from collections.abc import Callable

import numpy as np

from ..mechanism import Kind, Measures, Mechanism
from .body import BODY
from .dry_friction import DRY_FRICTION
from .joint import JOINT
from .outside import OUTSIDE, OUTSIDE_SIGNALS
from .signal import INPUT, OUTPUT

Maker = Callable[[str, Measures, np.random.Generator], Mechanism]

FORMS: dict[tuple[Kind, str], Maker] = {
    **{("joint", name): maker for name, maker in (DRY_FRICTION | JOINT).items()},
    **{("body", name): maker for name, maker in BODY.items()},
    **{("input", name): maker for name, maker in INPUT.items()},
    **{("output", name): maker for name, maker in OUTPUT.items()},
}

__all__ = ["FORMS", "OUTSIDE", "OUTSIDE_SIGNALS", "Maker"]
