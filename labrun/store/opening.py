"""What a person names, opened: a run, or a recording folder as the run it would be imported as."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from labrun.store.locate import find_run
from labrun.store.reading import Run, open_run
from labrun.store.recording import is_recording


@contextmanager
def open_target(target: str, results: Path) -> Iterator[Run]:
    """Open a run or a recording for reading; leaves nothing behind.

    Parameters
    ----------
    target
        What `labrun.store.locate.find_run` takes, or a recording folder.
    results
        Where runs are.

    Raises
    ------
    RequestError
        There is no such run; names what is nearest.
    RecordingError
        It cannot be read, or the recording has faults.
    """
    folder = Path(target).expanduser()
    if not is_recording(folder):
        with open_run(find_run(target, results)) as run:
            yield run
        return
    from labrun.store.importing import import_recording

    # A run is read from disk, trial by trial; a recording becomes one, for as long as it is looked at.
    with (
        TemporaryDirectory(prefix="labrun-") as scratch,
        open_run(import_recording(folder, Path(scratch))) as run,
    ):
        run.path = folder.absolute()  # where the person knows it to be
        yield run
