"""The emulators of a run with `--emulate`, from before its rig is built until after it is closed."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import RequestError, SpecError

if TYPE_CHECKING:
    from labrun.runner.emulated.bench import EmulatedBench
    from labrun.runner.progress import Progress
    from labrun.spec.experiment import Experiment


@contextmanager
def behind_the_drivers(
    experiment: "Experiment", path: Path, *, seed: int, emulate: bool, progress: "Progress"
) -> "Iterator[EmulatedBench | None]":
    """Run the emulators of an experiment's devices; None where they are not asked for.

    Raises
    ------
    RequestError
        None of the devices has an emulator, so that a dry run would do the same.
    SpecError
        The experiment names no bench for them to feel and move.
    """
    if not emulate:
        yield None
        return
    from labrun.runner.emulated.bench import EmulatedBench, has_emulator

    rig = experiment.rig
    if rig.scene is None:
        raise SpecError(
            f"{path} names no scene, so there is no bench for the emulators to move and feel",
            hint='add scene = "..." to [rig]; labrun plugins lists the scenes',
        )
    if not any(has_emulator(table.plugin) for table in rig.devices.values()):
        raise RequestError(
            "none of its devices has an emulator",
            hint="--dry-run simulates them; labrun plugins lists the emulators",
        )
    progress.phase("starting the emulators")
    with EmulatedBench(rig.devices, rig.scene, seed=seed) as bench:
        yield bench
