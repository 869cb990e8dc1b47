"""Which model a run or a recording is held against."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import RequestError

if TYPE_CHECKING:
    from labrun.models import Model


@dataclass(frozen=True, slots=True)
class GapPlan:
    """A model, and which recorded channel is which of its inputs and outputs."""

    model: "Model"
    signals: Mapping[str, str]


def plan_for(target: Path, model: str | Path | None, workspace: Path) -> GapPlan:
    """Return the model that was asked for, that the experiment's ``[gap]`` (or ``[fit]``) names, or that stands beside a
    recording.

    Raises
    ------
    RequestError
        There is nothing at `target`, or no model is named anywhere.
    """
    from labrun.fit.run_fit import plan_of
    from labrun.models import load_model

    given = load_model(model) if model is not None else None
    own = _of_experiment(target, workspace, wanted=given is None)
    if own is not None:
        return GapPlan(given or own.model, own.signals)
    plan = plan_of(target, workspace, need_model=given is None)
    found = given or plan.model
    if found is None:
        raise RequestError(
            f"no model to hold {target} against", hint="name one with --model, or in [gap] of the experiment"
        )
    return GapPlan(found, plan.signals)


def _of_experiment(target: Path, workspace: Path, *, wanted: bool) -> GapPlan | None:
    return None
