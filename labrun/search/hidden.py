"""What a new dry run hides, and the seal it gets."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import RequestError
from labrun.search.design import conditions

if TYPE_CHECKING:
    from labrun.models import Model
    from labrun.spec.experiment import Experiment
    from labrun.spec.loading import LoadedExperiment
    from labrun.store.seal import Seal


def sealed_choice(
    loaded: "LoadedExperiment", hide: Sequence[str], *, seed: int | None, dry_run: bool
) -> "tuple[Experiment, Seal]":
    """Return the experiment as its dry run carries it out, and the seal of what that hides.

    Parameters
    ----------
    hide, seed
        See `labrun.runner.hiding.choose_hidden`.

    Raises
    ------
    RequestError
        The run is no dry run, or what is to be hidden does not exist or does not fit.
    """
    from labrun.runner.concealment import concealed
    from labrun.runner.hiding import choose_hidden
    from labrun.store.seal import Seal

    if not dry_run:
        raise RequestError("--hide is for simulated benches: a real one hides enough", hint="add --dry-run")
    experiment = loaded.experiment
    hidden = choose_hidden(hide, experiment, named_model(loaded), conditions(experiment), seed=seed)
    return concealed(experiment, hidden), Seal.of(hidden)


def named_model(loaded: "LoadedExperiment") -> "Model | None":
    """Return the model that an experiment's ``[gap]`` names, else its ``[fit]``; None if it names none."""
    from labrun.models import load_model
    from labrun.spec.workspace import find_model_file

    experiment = loaded.experiment
    names = [table.model for table in (experiment.gap, experiment.fit) if table is not None and table.model]
    if not names:
        return None
    return load_model(find_model_file(names[0], loaded.path, Path.cwd()) or names[0])
