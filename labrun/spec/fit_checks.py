"""The table [fit]: whether the model it names is there."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from labrun import registry
from labrun.spec.names import suggest
from labrun.spec.plugin_checks import load_plugin
from labrun.spec.positions import KeyPath
from labrun.spec.problem import Problem
from labrun.spec.raw_tables import table
from labrun.spec.workspace import find_model_file, shipped_experiments

_GROUP = "labrun.models"


def check_fit(data: Mapping[str, Any], experiment: Path | None) -> Iterator[Problem]:
    """Yield what is wrong with the model of a fit, as far as that shows without reading it.

    Parameters
    ----------
    data
        The file as it was read.
    experiment
        The file. Without it there is no telling which folder a model would be beside, and nothing is looked for.
    """
    model = table(data, "fit").get("model")
    path: KeyPath = ("fit", "model")
    if experiment is None or not isinstance(model, str):
        return
    if find_model_file(model, experiment, Path()) is not None:
        return
    if model.endswith(".toml"):
        beside = sorted((experiment.parent / model).parent.glob("*.toml"))
        folder = Path(model).parent
        known = [str(folder / item.name) for item in beside if item != experiment]
        yield Problem(
            path, f"there is no such model file; {suggest(model, known, kind='model files')}", at_value=True
        )
    elif ":" in model or registry.is_installed(_GROUP, model):
        yield from load_plugin(_GROUP, model, path)[1]
    else:
        shipped = sorted(item.stem for item in (shipped_experiments() / "models").glob("*.toml"))
        if model not in shipped:
            known = [*shipped, *registry.names(_GROUP)]
            yield Problem(
                path, f"there is no such model; {suggest(model, known, kind='models')}", at_value=True
            )
