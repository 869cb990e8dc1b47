"""From a target to a question: data and the model that is asked about."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from labrun.errors import RequestError
from labrun.fit.dataset import Dataset, load_dataset
from labrun.models import Model


@dataclass(frozen=True)
class Question:
    """Data, and the model they are held against."""

    dataset: Dataset
    model: Model


def load_question(
    target: Path,
    model: str | Path | None,
    more: Sequence[Path],
    signals: Mapping[str, str],
    workspace: Path,
) -> Question:
    """Load the data and the model of a diagnosis.

    Raises
    ------
    RequestError
        No model is named anywhere, or data that do not belong together.
    """
    from labrun.gap.naming import plan_for

    plan = plan_for(target, model, workspace)
    wired = {**plan.signals, **signals}
    dataset = load_dataset(target, plan.model, wired)
    for other in more:
        dataset = _joined(dataset, load_dataset(other, plan.model, wired))
    return Question(dataset, plan.model)


def _joined(one: Dataset, other: Dataset) -> Dataset:
    mine = [(signal.name, signal.unit) for signal in (*one.inputs, *one.outputs)]
    theirs = [(signal.name, signal.unit) for signal in (*other.inputs, *other.outputs)]
    if mine != theirs:
        raise RequestError(
            f"{other.source} has other channels than {one.source}: {theirs} beside {mine}",
            hint="diagnose together only what was recorded alike",
        )
    return replace(
        one,
        trials=(*one.trials, *other.trials),
        left_out=one.left_out + other.left_out,
        notes=(*one.notes, *other.notes),
    )
