"""The tables [fit] and [gap]: whether the method and the model it names are there, and the settings hold."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from labrun import registry
from labrun.spec.plugin_checks import check_settings, load_plugin
from labrun.spec.raw_tables import table
from labrun.spec.workspace import find_model_file, shipped_experiments
from labrun.toml import Fault, KeyPath, suggest

_GROUP = "labrun.models"
_METHODS = "labrun.fits"


def check_fit(data: Mapping[str, Any], experiment: Path | None) -> Iterator[Fault]:
    """Yield what is wrong with a fit's methods, settings and model, as far as that shows without reading the model.

    Parameters
    ----------
    data
        The file as it was read.
    experiment
        The file. Without it there is no telling which folder a model would be beside, and nothing is looked for.
    """
    fit = table(data, "fit")
    method = fit.get("method", "model") if fit else None
    loaded, problems = load_plugin(_METHODS, method, ("fit", "method"))
    yield from problems
    if loaded is not None:
        yield from check_settings(loaded, table(fit, "settings"), ("fit", "settings"), [])
    for name, settings in table(fit, "methods").items():
        loaded, problems = load_plugin(_METHODS, name, ("fit", "methods", name))
        yield from problems
        if loaded is not None and isinstance(settings, Mapping):
            shared = {k: v for k, v in table(fit, "settings").items() if k in loaded.Settings.model_fields}
            yield from check_settings(loaded, {**shared, **settings}, ("fit", "methods", name), [])
    yield from _check_model(fit.get("model"), ("fit", "model"), experiment)


def check_gap(data: Mapping[str, Any], experiment: Path | None) -> Iterator[Fault]:
    """Yield what is wrong with the model that a run is compared with; see `check_fit`."""
    yield from _check_model(table(data, "gap").get("model"), ("gap", "model"), experiment)


def _check_model(model: object, path: KeyPath, experiment: Path | None) -> Iterator[Fault]:
    if experiment is None or not isinstance(model, str):
        return
    if find_model_file(model, experiment, Path()) is not None:
        return
    if model.endswith(".toml"):
        beside = sorted((experiment.parent / model).parent.glob("*.toml"))
        folder = Path(model).parent
        known = [str(folder / item.name) for item in beside if item != experiment]
        yield Fault(
            path, f"there is no such model file; {suggest(model, known, kind='model files')}", at_value=True
        )
    elif ":" in model or registry.is_installed(_GROUP, model):
        yield from load_plugin(_GROUP, model, path)[1]
    else:
        shipped = sorted(item.stem for item in (shipped_experiments() / "models").glob("*.toml"))
        if model not in shipped:
            known = [*shipped, *registry.names(_GROUP)]
            yield Fault(
                path, f"there is no such model; {suggest(model, known, kind='models')}", at_value=True
            )
