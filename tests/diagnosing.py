"""A diagnosis of stored data, in memory: nothing is written."""

from dataclasses import replace
from pathlib import Path

from labrun.app.question import ask
from labrun.gap import Options, diagnose_dataset


def diagnose(target: Path, *, model=None, more=(), workspace: Path = Path(), options: Options | None = None):
    question = ask(target, model, more, workspace=workspace)
    return replace(diagnose_dataset(question.dataset, question.model, options), source=str(target))
