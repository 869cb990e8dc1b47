"""A recording made elsewhere becomes a run like any other."""

import shutil
from pathlib import Path

import numpy as np

from labrun.devices.samples import Channel, FloatArray, Samples
from labrun.store.folder import RunFolder
from labrun.store.provenance import software_and_machine
from labrun.store.recording import RecordedTrial, SignalInfo, read_recording
from labrun.store.trial import TrialOutcome


def import_recording(folder: Path, results: Path) -> Path:
    """Store a recording as a packed run; each trial has the streams ``input`` and ``output``.

    Parameters
    ----------
    folder
        Holds ``recording.toml`` and CSV files; is left as it is.
    results
        Where runs are.

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
            for index, trial in enumerate(recording.trials):
                _store(run, index, trial, recording.inputs, recording.outputs)
            run.pack()
            run.journal.append("finished", trials={"done": len(recording.trials), "rejected": 0, "failed": 0})
    except BaseException:
        shutil.rmtree(run.path, ignore_errors=True)
        raise
    return run.path


def _store(
    run: RunFolder,
    index: int,
    trial: RecordedTrial,
    inputs: tuple[SignalInfo, ...],
    outputs: tuple[SignalInfo, ...],
) -> None:
    rate_hz = 1 / float(np.median(np.diff(trial.time_s))) if len(trial.time_s) > 1 else 0.0
    writer = run.writer(index)
    for name, signals, values in (("input", inputs, trial.inputs), ("output", outputs, trial.outputs)):
        if signals:
            channels = tuple(Channel(signal.name, signal.unit) for signal in signals)
            writer.append(name, channels, rate_hz, _samples(trial.time_s, values))
    outcome = TrialOutcome(
        index,
        dict(trial.condition),
        trial.repeat - 1,  # recordings count repeats from 1, runs from 0
        duration_s=float(trial.time_s[-1]) if len(trial.time_s) else 0.0,
    )
    writer.finish(outcome, None, None)


def _samples(time_s: FloatArray, values: FloatArray) -> Samples:
    # A recording has one time: it stands for the device's and the host's, and comes back unchanged.
    return Samples(time_s, time_s, values)
