"""Which model a run or a recording is held against."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from labrun.errors import RequestError
from labrun.models import Model
from labrun.spec.experiment import GapTable


@dataclass(frozen=True, slots=True)
class GapPlan:
    """A model, and which recorded channel is which of its inputs and outputs."""

    model: Model
    signals: Mapping[str, str]


def plan_for(target: Path, model: str | Path | None, workspace: Path) -> GapPlan:
    """Return the model that was asked for, that the experiment names, or that stands beside a recording.

    An experiment names it in ``[gap]``, or else in ``[fit]``.

    Raises
    ------
    RequestError
        There is nothing at `target`, or no model is named anywhere.
    """
    from labrun.fit.run_fit import plan_of
    from labrun.models import load_model

    given = load_model(model) if model is not None else None
    table = _gap_table(target)
    if table is not None:
        return GapPlan(given or _named(table, workspace), table.signals)
    plan = plan_of(target, workspace, need_model=given is None)
    found = given or plan.model
    if found is None:
        raise RequestError(
            f"no model to hold {target} against", hint="name one with --model, or in [gap] of the experiment"
        )
    return GapPlan(found, plan.signals)


def _gap_table(target: Path) -> GapTable | None:
    """Return what the experiment of a run says, None for recordings and for experiments that say nothing."""
    from labrun.fit.run_dataset import imported_channels
    from labrun.spec.loading import loads_experiment
    from labrun.store.reading import open_run
    from labrun.store.recording import is_recording

    if is_recording(target) or not target.exists():
        return None
    run = open_run(target)
    if imported_channels(run.experiment_toml):
        return None
    return loads_experiment(run.experiment_toml, run.name, plugins=False).experiment.gap


def _named(table: GapTable, workspace: Path) -> Model:
    from labrun.models import load_model
    from labrun.spec.workspace import find_model_file

    return load_model(find_model_file(table.model, None, workspace) or table.model)
