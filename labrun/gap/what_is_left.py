"""What a diagnosis says of what its causes leave: how much of it could be learned, and a law for it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from labrun.effects import AttachedEffect


@dataclass(frozen=True, slots=True)
class Learnable:
    """What any model could gain at least: the part of the squares left that a regression without physics predicts.

    Attributes
    ----------
    pieces
        In pieces of time that it did not see, of conditions that it knows.
    conditions
        In conditions that it did not see; None where there is one only.
    """

    pieces: float
    conditions: float | None

    @property
    def sentence(self) -> str:
        """What it says."""
        most = 100 * max(self.pieces, self.conditions or 0.0)
        return f"Of what is left, at least {most:.0f} % could be learned, at most {100 - most:.0f} % is noise"


@dataclass(frozen=True, slots=True)
class BeyondScatter:
    """What a fit leaves that is no trial's own.

    Attributes
    ----------
    learnable
        Part of the squared residual that is predicted of withheld pieces, 0 to 1.
    size
        Root mean square, in units of the noise of the mean of repeats.
    chance_of_lines
        How probable it is that noise has such lines in its spectrum.
    """

    learnable: float = 0.0
    size: float = 0.0
    chance_of_lines: float = 1.0


@dataclass(frozen=True)
class Term:
    """A term of a law.

    Attributes
    ----------
    formula
        In multiples of what is typical, as the effect's file writes it.
    size
        At typical motion, in `unit`.
    chosen
        Share of resamples of the trials in which it was chosen again.
    """

    formula: str
    size: float
    unit: str
    chosen: float


@dataclass(frozen=True)
class RestLaw:
    """What a law of a few terms explains of the rest that a diagnosis leaves.

    Attributes
    ----------
    terms
        None where no law predicts withheld trials.
    share
        Of the rest, on trials (of one condition: blocks of time) that neither choice nor fit has seen.
    before, after
        Root mean square of the rest in units of one trial's noise, as fitted.
    toml
        The law as a file of effects; "" where there is none.
    values
        Its sizes, SI.
    corrected : parameter -> value
        Of the model refitted with it; `effects` are the causes, refitted too.
    tried
        How many terms there were to choose from.
    """

    site: str
    kind: str
    terms: tuple[Term, ...]
    share: float
    before: float
    after: float
    toml: str
    values: tuple[float, ...]
    corrected: Mapping[str, float]
    effects: tuple[AttachedEffect, ...]
    tried: int

    @property
    def sentence(self) -> str:
        """What it says."""
        if not self.terms:
            return f"No law of up to three of {self.tried} terms predicts what is left of trials it has not seen."
        law = " ".join(f"{one.size:+.3g} {one.formula}" for one in self.terms).removeprefix("+")
        often = ", ".join(f"{100 * one.chosen:.0f} %" for one in self.terms)
        what, unit = ("force" if self.kind != "input" else "signal"), self.terms[0].unit
        return (
            f"Missing {what} at {self.site}: {law} {unit} removes {100 * self.share:.0f} % of the squares that are "
            f"left on data it has not seen (chosen again in {often} of resamples, from {self.tried} terms)."
        )

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap diagnose --explain-rest --json`` prints."""
        return {
            "site": self.site,
            "kind": self.kind,
            "terms": [
                {"formula": one.formula, "size": one.size, "unit": one.unit, "chosen": one.chosen}
                for one in self.terms
            ],
            "share_on_withheld": self.share,
            "before": self.before,
            "after": self.after,
            "toml": self.toml,
            "tried": self.tried,
        }
