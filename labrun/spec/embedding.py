"""Files that an experiment names for its loops: their content becomes part of it, and a stored run needs no other."""

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from labrun.errors import SpecError
from labrun.spec.plugin_checks import load_plugin
from labrun.spec.raw_tables import table
from labrun.spec.workspace import find_model_file
from labrun.toml import Fault, KeyPath, suggest


def embed_files(data: dict[str, Any], experiment: Path | None) -> list[Fault]:
    """Put the content of named files in the place of their names, in the file as it was read.

    Parameters
    ----------
    data
        The file as it was read; changed in place.
    experiment
        Where it stands: files are looked for beside it. None for what a run stored, which names no file any more.

    Returns
    -------
    list of Fault
        Files that are not there, or do not hold.
    """
    problems: list[Fault] = []
    if experiment is None:
        return problems
    for group, holder, key, path in _parts(data):
        keys = holder.get(key)
        plugin, _ = load_plugin(group, keys.get("plugin"), ()) if isinstance(keys, dict) else (None, [])
        embed = getattr(plugin, "embed", None)
        if embed is None or not isinstance(keys, dict):
            continue
        try:
            holder[key] = embed(keys, _finder(experiment))
        except SpecError as error:
            named = next(
                (key for key, value in keys.items() if isinstance(value, str) and value in str(error)), None
            )
            at = path if named is None else (*path, named)
            problems.append(Fault(at, str(error).replace("\n  ", "; "), at_value=named is not None))
    return problems


def _parts(data: Mapping[str, Any]) -> Iterator[tuple[str, dict[str, Any], str, KeyPath]]:
    loops = table(data, "track", "loops")
    for name in loops:
        loop, path = table(loops, name), ("track", "loops", name)
        yield "labrun.references", loop, "reference", (*path, "reference")
        yield "labrun.feedbacks", loop, "feedback", (*path, "feedback")
        controllers = table(loop, "controllers")
        for controller in list(controllers):
            yield "labrun.controllers", controllers, controller, (*path, "controllers", controller)


def _finder(experiment: Path) -> Callable[[str], Path]:
    def find(name: str) -> Path:
        found = find_model_file(name, experiment, Path())
        if found is None:
            beside = sorted((experiment.parent / name).parent.glob(f"*{Path(name).suffix}"))
            known = [str(Path(name).parent / item.name) for item in beside if item != experiment]
            kind = f"{Path(name).suffix} files".strip()
            raise SpecError(f'there is no file "{name}"; {suggest(name, known, kind=kind)}')
        return found

    return find
