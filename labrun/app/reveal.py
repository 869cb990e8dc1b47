"""What a sealed dry run hid, beside what its diagnosis said."""

from pathlib import Path

from labrun.app.kept_diagnosis import read_stored
from labrun.blind import Compared
from labrun.blind import reveal as open_seal
from labrun.store import find_run


def reveal(target: str | Path, *, results: str | Path = "results") -> Compared:
    """Open the seal of a run that was made with ``--hide`` and diagnosed.

    Parameters
    ----------
    target
        An experiment's name (its latest run), or a run folder.
    results
        Where runs are.

    Raises
    ------
    RequestError
        There is no such run, or no diagnosis: the seal stays closed.
    RecordingError
        Nothing is sealed, or the seal is broken.
    """
    run = find_run(str(target), Path(results))
    stored = read_stored(run)  # without a diagnosis the seal stays closed
    return Compared(open_seal(run), stored)
