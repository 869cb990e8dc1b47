"""From a file to an experiment, or to everything that is wrong with it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from labrun.errors import SpecError
from labrun.spec.checks import cross_check
from labrun.spec.embedding import embed_files
from labrun.spec.experiment import Experiment
from labrun.spec.overrides import apply_overrides
from labrun.toml import KeyPath, Places, locate, parsed, refusal, text_of, validate


@dataclass(frozen=True, slots=True)
class LoadedExperiment:
    """An experiment, where it came from, and its full text.

    Attributes
    ----------
    experiment
        What the file says, overrides and defaults included.
    name
        The file's stem; runs are filed under it.
    path
        The file. Of a stored experiment, its name alone.
    resolved_toml
        The experiment with overrides and defaults written out; loading it gives an equal experiment.
    origins
        The keys that overrides have set, and the override each came from.
    """

    experiment: Experiment
    name: str
    path: Path
    resolved_toml: str
    origins: Mapping[KeyPath, str] = field(default_factory=dict, compare=False)

    def place(self, key: KeyPath) -> str:
        """Return where the value of a key comes from: "file:line:column", or the override that brought it."""
        for path, override in self.origins.items():
            if key[: len(path)] == path:
                return override
        try:
            position = locate(self.path.read_text(encoding="utf-8")).of_value(key)
        except (OSError, UnicodeDecodeError):  # the file of a stored experiment is its name alone
            return str(self.path)
        return f"{self.path}:{position.line}:{position.column}"


def load_experiment(path: Path, overrides: Sequence[str] = ()) -> LoadedExperiment:
    """Read an experiment file.

    Parameters
    ----------
    path
        The file.
    overrides
        Texts ``key=value``, see `labrun.spec.overrides.apply_overrides`.

    Raises
    ------
    RequestError
        The file cannot be read.
    SpecError
        All that is wrong with it, each with file, line and column.
    """
    text = text_of(path, what="experiment file")
    return _load(text, path.stem, path, overrides, beside=path)


def loads_experiment(
    text: str, name: str, *, plugins: bool = True, beside: Path | None = None
) -> LoadedExperiment:
    """Read an experiment from its text, for example from the spec stored with a run.

    Parameters
    ----------
    text
        The file's content.
    name
        What the experiment is filed under.
    plugins
        False to read what a run stored: how its tables fit together, and to the plugins, was checked when the run
        began. The plugins need not be installed to look at what they measured.
    beside
        Where the text stood as a file, if it names others; what a run stored names none.

    Raises
    ------
    SpecError
        All that is wrong with it.
    """
    return _load(text, name, Path(f"{name}.toml"), (), plugins=plugins, beside=beside)


def _load(
    text: str,
    name: str,
    path: Path,
    overrides: Sequence[str],
    *,
    beside: Path | None = None,
    plugins: bool = True,
) -> LoadedExperiment:
    data = parsed(text, str(path), kind=SpecError)
    _expand_short_forms(data, overrides)
    origins = apply_overrides(data, overrides)
    unreadable = embed_files(data, beside)
    experiment, problems = validate(Experiment, data)
    problems += unreadable
    if plugins:
        problems += cross_check(data, beside)
    if experiment is None or problems:
        places = Places(str(path), text, data, origins)
        raise refusal(SpecError, str(path), places.of_all(problems))
    return LoadedExperiment(
        cast("Experiment", experiment), name, path, resolved(cast("Experiment", experiment)), origins
    )


def resolved(experiment: Experiment) -> str:
    """Return an experiment as TOML, defaults written out."""
    import tomli_w

    tree = experiment.model_dump(mode="python", by_alias=True, exclude_none=True)
    return tomli_w.dumps(tree)


def _expand_short_forms(data: dict[str, Any], overrides: Sequence[str]) -> None:
    """Write out ``scene = "name"`` and ``repeats = 3`` where an override reaches inside them."""
    keys = [override.partition("=")[0].strip() for override in overrides]
    rig, trial = data.get("rig"), data.get("trial")
    reaches_scene = any(key.startswith("rig.scene.") for key in keys)
    if reaches_scene and isinstance(rig, dict) and isinstance(rig.get("scene"), str):
        rig["scene"] = {"plugin": rig["scene"]}
    reaches_repeats = any(key.startswith("trial.repeats.") for key in keys)
    if reaches_repeats and isinstance(trial, dict) and type(trial.get("repeats")) is int:
        trial["repeats"] = {"min": trial["repeats"], "max": trial["repeats"]}
