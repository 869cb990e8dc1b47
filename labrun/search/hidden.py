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

SAME_AS = "same-as:"


def sealed_choice(
    loaded: "LoadedExperiment",
    hide: Sequence[str],
    *,
    seed: int | None,
    simulated: bool,
    again: "Seal | None" = None,
) -> "tuple[Experiment, Seal]":
    """Return the experiment as its dry run carries it out, and the seal of what that hides.

    Parameters
    ----------
    hide, seed
        See `labrun.runner.hiding.choose_hidden`.
    again
        What another run hides, to be hidden here, too.

    Raises
    ------
    RequestError
        The bench of the run is not simulated, or what is to be hidden does not exist or does not fit.
    """
    from labrun.runner.concealment import concealed
    from labrun.runner.hiding import choose_hidden
    from labrun.store.seal import Seal

    if not simulated:
        raise RequestError(
            "--hide is for simulated benches: a real one hides enough", hint="add --dry-run, or --emulate"
        )
    experiment = loaded.experiment
    if again is not None:
        return concealed(experiment, again.hidden()), Seal.of(again.hidden())
    hidden = choose_hidden(hide, experiment, named_model(loaded), conditions(experiment), seed=seed)
    return concealed(experiment, hidden), Seal.of(hidden)


def bench_of(hide: Sequence[str], results: Path) -> "tuple[int, Seal] | None":
    """Return seed and seal of the run whose simulated bench is to be used again, None if none is asked for.

    Parameters
    ----------
    hide
        ``["same-as:RUN"]``: an experiment's name (its latest run) or a run folder.

    Raises
    ------
    RequestError
        No such run, or one that hides nothing under seal.
    """
    if not any(one.startswith(SAME_AS) for one in hide):
        return None
    if len(hide) > 1:
        raise RequestError(f"--hide {SAME_AS}RUN stands alone")
    from labrun.store.folder import RunFolder
    from labrun.store.locate import find_run
    from labrun.store.seal import is_sealed, read_seal

    run = find_run(hide[0].removeprefix(SAME_AS), results)
    origin = RunFolder(run).provenance
    if not is_sealed(origin):
        raise RequestError(
            f"{run} hides nothing under seal",
            hint="name a run that was started with --hide random or --hide EFFECT@SITE",
        )
    return int(origin["seed"]), read_seal(run, origin)


def named_model(loaded: "LoadedExperiment") -> "Model | None":
    """Return the model that an experiment's ``[gap]`` names, else its ``[fit]``; None if it names none."""
    from labrun.models import load_model
    from labrun.spec.workspace import find_model_file

    experiment = loaded.experiment
    names = [table.model for table in (experiment.gap, experiment.fit) if table is not None and table.model]
    if not names:
        return None
    return load_model(find_model_file(names[0], loaded.path, Path.cwd()) or names[0])
