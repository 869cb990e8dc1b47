"""Open-loop control by an analytic inverse of the mechanism."""

from collections.abc import Mapping
from typing import Any, ClassVar

from labrun.control.protocol import LoopContext, Numbers, VectorStep
from labrun.learned import load_inverse
from labrun.toml import Table, checked


class InverseSettings(Table):
    """Keys of `inverse`: the name of an analytic inverse, an entry point of group ``labrun.inverses``."""

    inverse: str


class InverseController:
    """The drives that ought to bring about the reference; the feedback is recorded, and not looked at."""

    Settings: ClassVar[type[Table]] = InverseSettings
    several: ClassVar[bool] = True

    def __init__(self, settings: Mapping[str, Any], context: LoopContext) -> None:  # noqa: ARG002
        self.inverse = load_inverse(checked(InverseSettings, settings).inverse)

    def update(self, step: VectorStep) -> Numbers:
        """Return the inverse of the reference."""
        return self.inverse(step.reference)

    def applied(self, drives: Numbers) -> None:
        """Take no note: it has no memory."""
