"""Constraints of a design, on its variables and on its simulation."""

import ast
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from labrun.arrays import FloatArray
from labrun.experiment import SUMMARIES, Design
from labrun.search import Constraint, Violations
from labrun.toml import evaluate, names_in

_ACTIVE = 0.02
"""A constraint whose sides are closer than this share of the greater one, or of the range that what it summarises runs
through, holds the design back: next to a bound of 0 shares of the sides say nothing."""


@dataclass(frozen=True, slots=True)
class Margin:
    """The margin of a design to a constraint.

    Attributes
    ----------
    text
        As the file has it.
    value, bound
        Its two sides; of a constraint of more than one comparison there are none.
    span
        The widest range of a channel that it summarises, over the motion; 0 where it names variables only.
    """

    text: str
    value: float | None
    bound: float | None
    span: float = 0.0

    @property
    def active(self) -> bool:
        """Tell whether the constraint is active."""
        if self.value is None or self.bound is None:
            return False
        return abs(self.value - self.bound) <= _ACTIVE * max(abs(self.value), abs(self.bound), self.span)


class DesignConstraints:
    """The `where` of a design: `before` needs the variables only, `after` summaries of channels as well."""

    def __init__(self, design: Design) -> None:
        constraints = [Constraint(text, ("design", "where", n)) for n, text in enumerate(design.where)]
        self.before = [
            constraint for constraint in constraints if names_in(constraint.text) <= design.variables.keys()
        ]
        self.after = [constraint for constraint in constraints if constraint not in self.before]

    @property
    def summaries(self) -> set[tuple[str, str]]:
        """What has to be known of channels: kind of summary, and channel."""
        names = {name for constraint in self.after for name in names_in(constraint.text)}
        parts = (name.partition("_") for name in names)
        return {(kind, channel) for kind, _, channel in parts if kind in SUMMARIES and channel}

    @staticmethod
    def violations(of: list[Constraint], names: Mapping[str, object]) -> Violations:
        """Return the number of violated constraints and their relative violation.

        Raises ConstraintError: one of them cannot be computed.
        """
        sizes, texts = [], []
        for constraint in of:
            miss = float(constraint.violation(names))
            if miss > 0:
                sides = _sides(constraint.text, names)
                sizes.append(miss / (abs(sides[1]) if sides is not None and sides[1] else 1.0))
                texts.append(constraint.text)
        return Violations(len(sizes), float(sum(sizes)), tuple(texts))

    def margins(self, names: Mapping[str, object], spans: Mapping[str, float]) -> list[Margin]:
        """Return the margin to every constraint, in the order of the file.

        `spans`: range that every summarised channel runs through.
        """
        margins = []
        for constraint in sorted((*self.before, *self.after), key=lambda c: str(c.key)):
            value, bound = _sides(constraint.text, names) or (None, None)
            channels = [name.partition("_")[2] for name in names_in(constraint.text)]
            span = max((spans[name] for name in channels if name in spans), default=0.0)
            margins.append(Margin(constraint.text, value, bound, span))
        return margins


def summary(kind: str, values: FloatArray) -> float:
    """Return one number of a channel's values: ``max``, ``min``, ``mean``, ``rms``, ``final`` or ``peak``."""
    match kind:
        case "max":
            return float(values.max())
        case "min":
            return float(values.min())
        case "mean":
            return float(values.mean())
        case "rms":
            return float(np.sqrt(np.mean(values**2)))
        case "final":
            return float(values[-1])
        case "peak":
            return float(np.abs(values).max())
    raise ValueError(f"unknown summary {kind!r}")


def _sides(text: str, names: Mapping[str, object]) -> tuple[float, float] | None:
    """Return both sides of a single comparison, the bound last; None of anything else."""
    tree = ast.parse(text.strip(), mode="eval").body
    if not isinstance(tree, ast.Compare) or len(tree.ops) != 1:
        return None
    left, right = (
        float(evaluate(ast.unparse(side), names))  # type: ignore[arg-type]
        for side in (tree.left, tree.comparators[0])
    )
    return (right, left) if isinstance(tree.left, ast.Constant) else (left, right)
