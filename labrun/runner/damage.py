"""Which specimens are no longer what they were, and by which trial."""

from labrun.spec import BROKEN, PAST, ByHand, Condition, DamageTable, condition_key, condition_text
from labrun.store import TrialOutcome

_Specimen = tuple[tuple[str, float | str], ...]


class Damage:
    """Knows what trials have done to the specimens of a run: those that differ in what is set by hand, or the one.

    Parameters
    ----------
    table
        Of the experiment file; None if nothing can be damaged.
    by_hand
        What tells specimens apart.
    """

    def __init__(self, table: DamageTable | None, by_hand: ByHand | None) -> None:
        self._table = table
        by_hand_names = [] if by_hand is None else by_hand.names
        self._names = frozenset(by_hand_names if table is None or not table.of else table.of)
        self._by: dict[_Specimen, TrialOutcome] = {}

    def would(self, condition: Condition) -> bool:
        """Tell whether a condition takes its specimen past its limit."""
        return self._table is not None and self._table.when is not None and bool(self._table.when(condition))

    def done_by(self, outcome: TrialOutcome) -> str:
        """Return what a trial did to its specimen: ``"past its limit"``, ``"broken"``, or nothing, an empty text.

        A trial under a damaging condition counts as soon as it ran, whatever became of it.
        """
        table = self._table
        if table is None:
            return ""
        if table.broken is not None:
            names = {**outcome.condition, **outcome.objectives}
            if table.broken.names.keys() <= names.keys() and table.broken(names):
                return BROKEN
        return PAST if self.would(outcome.condition) else ""

    def take(self, outcome: TrialOutcome) -> str:
        """Note what a trial did; return a sentence on it where its specimen was whole before, else an empty text."""
        specimen = self._specimen(outcome.condition)
        if not outcome.damage or specimen in self._by:
            return ""
        self._by[specimen] = outcome
        who = condition_text(dict(specimen)) or "what is measured"
        return (
            f"trial {outcome.index}: {who} is {outcome.damage} from here on; nothing more is measured on it"
        )

    def is_whole(self, condition: Condition) -> bool:
        """Tell whether anything can be measured on a condition's specimen."""
        return self._specimen(condition) not in self._by

    def forget(self, mounting: int) -> None:
        """Take back what the trials of a wrong mounting did: it was to something else."""
        self._by = {key: outcome for key, outcome in self._by.items() if outcome.mounting != mounting}

    def _specimen(self, condition: Condition) -> _Specimen:
        return condition_key({name: value for name, value in condition.items() if name in self._names})
