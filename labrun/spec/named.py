"""From what a person types to a loaded experiment."""

from collections.abc import Sequence
from pathlib import Path

from labrun.errors import RequestError
from labrun.spec.loading import LoadedExperiment, load_experiment
from labrun.spec.workspace import find_experiment


def load_named(
    name: str, workspace: Path, overrides: Sequence[str] = (), *, kind: str | None = None
) -> LoadedExperiment:
    """Find an experiment by name or path, and load it.

    Parameters
    ----------
    name
        A name or a path.
    workspace
        The folder a person works in.
    overrides
        ``key=value``, each replacing one key of the file.
    kind
        The kind the command is for; None takes any.

    Raises
    ------
    RequestError
        No such experiment, a file that does not hold, or an experiment of another kind.
    """
    loaded = load_experiment(find_experiment(name, workspace), overrides)
    found = loaded.experiment.kind
    if kind is not None and found != kind:
        raise RequestError(
            f"{loaded.name} is no {kind}: its file says kind = {found!r}",
            hint=f"labrun {found} {name}",
        )
    return loaded
