"""What is hidden from a diagnosis: effects in dry runs, under seal; and sealed cases that score it."""

from typing import TYPE_CHECKING, Any

from labrun.blind.concealment import concealed
from labrun.blind.hiding import HiddenBench, hidden_bench, named_model
from labrun.blind.judging import GOOD, STRENGTHS, Judged
from labrun.blind.revealed import Compared, Hidden, Revealed, reveal
from labrun.blind.scoring import Scores, Share
from labrun.blind.seal import SEALED, Seal, is_sealed, read_seal, redacted, write_seal

if TYPE_CHECKING:
    from labrun.blind.diagnosis_check import Checked, check

__all__ = [
    "GOOD",
    "SEALED",
    "STRENGTHS",
    "Checked",
    "Compared",
    "Hidden",
    "HiddenBench",
    "Judged",
    "Revealed",
    "Scores",
    "Seal",
    "Share",
    "check",
    "concealed",
    "hidden_bench",
    "is_sealed",
    "named_model",
    "read_seal",
    "redacted",
    "reveal",
    "write_seal",
]


def __getattr__(name: str) -> Any:
    """Load the check of the diagnosis when it is asked for: a dry run that hides something needs no diagnosis."""
    if name in ("Checked", "check"):
        from labrun.blind import diagnosis_check

        return getattr(diagnosis_check, name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
