"""A recording made elsewhere becomes a run like any other."""

import shutil
from pathlib import Path

from labrun.devices import Channel, Samples
from labrun.store.folder import RunFolder
from labrun.store.provenance import software_and_machine
from labrun.store.reading import outcomes_of
from labrun.store.recording import read_recording


def import_recording(folder: Path, results: Path) -> Path:
    """Store a recording as a packed run; each trial has the streams ``input`` and ``output``.

    Parameters
    ----------
    folder
        Holds ``recording.toml`` and CSV files; is left as it is.

    Returns
    -------
    Path
        The run folder.

    Raises
    ------
    RecordingError
        The recording has faults: nothing is imported.
    StoreError
        The run cannot be written: nothing is imported.
    """
    recording = read_recording(folder)
    provenance = {"imported_from": str(folder.absolute()), **software_and_machine()}
    run = RunFolder.create(results, recording.name, (folder / "recording.toml").read_text(), provenance)
    try:
        with run.lock():
            for outcome, trial in zip(outcomes_of(recording), recording.trials, strict=True):
                writer = run.writer(outcome.index)
                for signals in trial.signals(recording):
                    channels = tuple(map(Channel, signals.columns, signals.units))
                    # its one time stands for the device's and the host's, and comes back unchanged
                    samples = Samples(signals.time_s, signals.time_s, signals.values)
                    writer.append(signals.name, channels, signals.rate_hz, samples)
                writer.finish(outcome, None, None)
            run.pack()
            run.journal.append("finished", trials={"done": len(recording.trials), "rejected": 0, "failed": 0})
    except BaseException:
        shutil.rmtree(run.path, ignore_errors=True)
        raise
    return run.path
