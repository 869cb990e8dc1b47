"""What a check found."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrun.gap.check.judging import Judged
from labrun.gap.check.scoring import Scores

FIRST_REPORTED_SEED = 1000
"""Seeds below are for development; those from here on are for figures that are reported."""


@dataclass(frozen=True)
class Checked:
    """Scores of a check and every case behind them.

    Attributes
    ----------
    only
        Kind of all cases; None where they are the generator's mixture.
    seal
        Hash over all answers that was printed before the first diagnosis; they were found to be the sealed ones.
    folder
        Where cases, diagnoses, answers and scores are.
    programmes
        Fingerprints of the code that diagnosed; more than one where workers differ.
    judged
        Every case, in order.
    """

    seed: int
    only: str | None
    seal: str
    folder: Path
    programmes: tuple[str, ...]
    judged: tuple[Judged, ...]
    scores: Scores

    @property
    def development(self) -> bool:
        """Whether the seed is one that the diagnosis may have been tuned on."""
        return self.seed < FIRST_REPORTED_SEED

    @property
    def mixed(self) -> bool:
        """Whether there is more than one kind of case."""
        return len(self.scores.kinds) > 1

    @property
    def use(self) -> str:
        """What the seed says about the figures, in a sentence."""
        if self.development:
            return f"seed {self.seed} is one of development (below {FIRST_REPORTED_SEED}): not for reporting"
        return f"seed {self.seed} is one for reporting: to be used once, with nothing tuned on it"

    def to_json(self) -> dict[str, Any]:
        """Return what ``labrun gap check --json`` prints."""
        return {
            "seed": self.seed,
            "only": self.only,
            "development": self.development,
            "seal": self.seal,
            "seal_holds": True,
            "programmes": list(self.programmes),
            "figures": self.scores.to_json(),
            "cases": [_case(one) for one in self.judged],
        }

    def to_text(self) -> str:
        """Return the figures on one screen."""
        from labrun.gap.check.text import screen

        return screen(self)

    def to_markdown(self) -> str:
        """Return the figures, the confusion matrix, and a table of every case."""
        from labrun.gap.check.tables import page

        return page(self)


def _case(one: Judged) -> dict[str, Any]:
    truth, said, shown = one.truth, one.said, one.shown
    return {
        "case": truth.case,
        "outcome": one.outcome,
        "kind": truth.kind,
        "bench": truth.bench,
        "gap": truth.gap,
        "strength": truth.strength,
        "repeats": truth.repeats,
        "hidden": [
            {"kind": cause.kind, "effect": cause.effect, "site": cause.site} for cause in truth.causes
        ],
        "forms": list(truth.forms),
        "verdict": said.verdict,
        "named": [
            {
                "kind": named.top.kind,
                "effect": named.top.effect,
                "site": named.top.site,
                "confidence": named.confidence,
                "indistinguishable_from": [
                    {"kind": rival.kind, "effect": rival.effect, "site": rival.site} for rival in named.rivals
                ],
            }
            for named in said.announced
        ],
        "predicted_shrinkage": None
        if said.shrinkage is None
        else {"value": said.shrinkage.value, "ci90": [said.shrinkage.low, said.shrinkage.high]},
        "true_shrinkage": None
        if shown is None
        else {"value": shown.value, "counted": shown.counted, "error": shown.error},
        "error": said.error,
        "seconds": said.seconds,
    }
