"""Track damaged specimens, and the trials of this or earlier runs that damaged them."""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from labrun.errors import LabrunError
from labrun.experiment import (
    BROKEN,
    PAST,
    ByHand,
    Condition,
    DamageTable,
    Experiment,
    condition_key,
    condition_text,
)
from labrun.runner.rig import Rig
from labrun.store import RunFolder, TrialOutcome, all_runs, open_run

_WORN = "worn"
"""Event of the journal."""
_Specimen = tuple[tuple[str, float | str], ...]


@dataclass(frozen=True, slots=True)
class Worn:
    """A specimen that an earlier run left damaged.

    Attributes
    ----------
    specimen
        What tells it from others.
    damage
        ``"past its limit"`` or ``"broken"``.
    by
        Which trial of which run did it.
    """

    specimen: Condition
    damage: str
    by: str


def worn_before(runs: Iterable[Path], table: DamageTable | None, by_hand: ByHand | None) -> list[Worn]:
    """Return the specimens that earlier runs left damaged, each by the first that did it.

    Specimens are the same where they agree in all names that tell specimens apart. A run that cannot be read, or that
    has other names, says nothing.
    """
    names = _names(table, by_hand)
    worns: dict[_Specimen, Worn] = {}
    if not names:
        return []
    for path in runs:
        try:
            with open_run(path) as run:
                outcomes = [
                    outcome
                    for outcome in run.outcomes
                    if outcome.damage and names <= outcome.condition.keys()
                ]
        except LabrunError:
            continue
        for outcome in outcomes:
            specimen = {name: outcome.condition[name] for name in sorted(names)}
            by = f"trial {outcome.index} of {path.parent.name}/{path.name}"
            worns.setdefault(condition_key(specimen), Worn(specimen, outcome.damage, by))
    return list(worns.values())


def _names(table: DamageTable | None, by_hand: ByHand | None) -> frozenset[str]:
    by_hand_names = [] if by_hand is None else by_hand.names
    return frozenset(by_hand_names if table is None or not table.of else table.of)


def worn_specimens(experiment: Experiment, rig: Rig, folder: RunFolder) -> list[Worn]:
    """Return the specimens that a run must leave alone; a resumed one the same as when it began.

    A simulated bench is a new one each time, with specimens of its own.
    """
    table = experiment.damage
    if table is None or table.fresh or rig.dry_run or rig.emulated:
        return []
    known = next((event["worn"] for event in folder.journal.events() if event["event"] == _WORN), None)
    if known is not None:
        return [Worn(**record) for record in known]
    earlier = [
        run for run in all_runs(folder.path.parent.parent) if run != folder.path and _on_the_bench(run)
    ]
    worn = worn_before(earlier, table, experiment.by_hand)
    folder.journal.append(_WORN, worn=[asdict(specimen) for specimen in worn])
    return worn


def _on_the_bench(run: Path) -> bool:
    try:
        origin = RunFolder(run).provenance
    except LabrunError:
        return False
    return not (origin.get("dry_run") or origin.get("emulated") or "imported_from" in origin)


class Damage:
    """Tracks the damage that trials do to the specimens of a run.

    Parameters
    ----------
    table
        Of the experiment file; None if nothing can be damaged.
    by_hand
        What tells specimens apart.
    worn
        Specimens that earlier runs left damaged.
    """

    def __init__(self, table: DamageTable | None, by_hand: ByHand | None, worn: Sequence[Worn] = ()) -> None:
        self._table = table
        self._names = _names(table, by_hand)
        self._worn = {condition_key(specimen.specimen): specimen for specimen in worn}
        self._by: dict[_Specimen, TrialOutcome] = {}

    def would(self, condition: Condition) -> bool:
        """Tell whether a condition takes its specimen past its limit."""
        return self._table is not None and self._table.when is not None and bool(self._table.when(condition))

    def done_by(self, outcome: TrialOutcome) -> str:
        """Return the damage by a trial: ``"past its limit"``, ``"broken"`` or ``""``.

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
        """Record the damage by a trial; return a sentence if its specimen was intact before, else "".

        What the plan takes past its limit is told of the first specimen only.
        """
        specimen = self._specimen(outcome.condition)
        if not outcome.damage or specimen in self._by:
            return ""
        planned = outcome.damage == PAST
        is_damaged = planned and any(o.damage == PAST for o in self._by.values())
        self._by[specimen] = outcome
        if is_damaged:
            return ""
        who = condition_text(dict(specimen)) or "what is measured"
        return (
            f"trial {outcome.index}: {who} is {outcome.damage} from here on; nothing more is measured on it"
            + (", nor on others that the plan takes there" if planned else "")
        )

    def is_whole(self, condition: Condition) -> bool:
        """Tell whether anything can be measured on a condition's specimen."""
        specimen = self._specimen(condition)
        return specimen not in self._by and specimen not in self._worn

    def known(self, conditions: Iterable[Condition]) -> list[str]:
        """Return a sentence on each specimen of these conditions that an earlier run left damaged."""
        wanted = dict.fromkeys(self._specimen(condition) for condition in conditions)
        return [
            f"{condition_text(dict(fromkey))} is {self._worn[fromkey].damage} since {self._worn[fromkey].by}; "
            "nothing is measured on it"
            for fromkey in wanted
            if fromkey in self._worn
        ]

    def forget(self, mounting: int) -> None:
        """Take back what the trials of a wrong mounting did: it was to something else."""
        self._by = {key: outcome for key, outcome in self._by.items() if outcome.mounting != mounting}

    def _specimen(self, condition: Condition) -> _Specimen:
        return condition_key({name: value for name, value in condition.items() if name in self._names})
