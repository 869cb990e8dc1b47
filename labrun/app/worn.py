"""Which specimens earlier runs on the bench left damaged, as it was known when a run began."""

from dataclasses import asdict
from pathlib import Path

from labrun.errors import LabrunError
from labrun.runner import Rig, Worn, worn_before
from labrun.spec import Experiment
from labrun.store import RunFolder, all_runs

_WORN = "worn"
"""Event of the journal."""


def worn_specimens(experiment: Experiment, rig: Rig, folder: RunFolder) -> list[Worn]:
    """Return the specimens that a run must leave alone; a resumed one the same as when it began.

    A simulated bench is a new one each time, with specimens of its own.
    """
    table = experiment.damage
    if table is None or table.fresh or rig.dry_run or rig.emulated:
        return []
    known = next((one["worn"] for one in folder.journal.events() if one["event"] == _WORN), None)
    if known is not None:
        return [Worn(**one) for one in known]
    earlier = [
        one for one in all_runs(folder.path.parent.parent) if one != folder.path and _on_the_bench(one)
    ]
    worn = worn_before(earlier, table, experiment.by_hand)
    folder.journal.append(_WORN, worn=[asdict(one) for one in worn])
    return worn


def _on_the_bench(run: Path) -> bool:
    try:
        origin = RunFolder(run).provenance
    except LabrunError:
        return False
    return not (origin.get("dry_run") or origin.get("emulated") or "imported_from" in origin)
