"""Analytic inverses of a mechanism, by name: what a network may correct instead of learning all of it."""

from collections.abc import Sequence
from typing import Protocol, cast

from labrun import registry

INVERSES = "labrun.inverses"


class Inverse(Protocol):
    """The function an entry point of group ``labrun.inverses`` names."""

    def __call__(self, values: Sequence[float]) -> tuple[float, ...]:
        """Return the drives, in the gait's own units, that ought to bring about this feedback of a loop."""
        ...


def load_inverse(name: str) -> Inverse:
    """Return an inverse by name; PluginError with the nearest name if there is none."""
    return cast("Inverse", registry.load(INVERSES, name))
