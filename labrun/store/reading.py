"""A stored run, read back: from a run folder, from ``run.h5`` alone, from a recording; a recording becomes a run."""

import json
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, closing, contextmanager
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from labrun.devices import Channel, Samples
from labrun.errors import RecordingError
from labrun.signals import LongSignals, Signals, joined
from labrun.store.folder import RunFolder, TrialSource, require_current
from labrun.store.journal import parse_events, software_and_machine
from labrun.store.locate import PACKED, SPEC, TRIALS, find_data
from labrun.store.packed_file import PackedTrials, RunTexts
from labrun.store.recording import Recording, is_recording, read_recording
from labrun.store.trial import SETTLE, TrialOutcome, known_units
from labrun.store.trial_file import BESIDE, COMMAND, trial_files


class Source(Protocol):
    """Where the signals of a run's trials are."""

    def tables(self, index: int) -> AbstractContextManager[Mapping[str, LongSignals]]:
        """Give all signals of one trial by name; readable within the ``with``."""
        ...

    def size(self) -> int:
        """Return how many bytes all trials take on disk."""
        ...

    def close(self) -> None:
        """Close what is open."""
        ...


class Run:
    """One stored run. Samples are read from disk when asked for.

    Attributes
    ----------
    path
        The run folder, or the ``run.h5`` that was opened; of a recording, its folder.
    identifier
        The run's own name, ``<UTC start>-<4 letters>``.
    experiment_toml
        The resolved experiment file; of a recording, its ``recording.toml``.
    provenance
        Versions, machine, devices, seed.
    outcomes
        Of every trial in order of execution, later marks applied.
    faults
        What was found damaged, one sentence each.
    """

    def __init__(
        self,
        path: Path,
        texts: RunTexts,
        outcomes: Sequence[TrialOutcome],
        source: Source,
        faults: Sequence[str] = (),
    ) -> None:
        self.path = path
        self.texts = texts
        self.name = texts.experiment
        self.identifier = texts.run
        self.experiment_toml = texts.spec_toml
        self.provenance: dict[str, Any] = json.loads(texts.provenance_json)
        self.outcomes = list(outcomes)
        self.events = parse_events(texts.journal_jsonl.encode(), f"journal of {path}")
        self.faults = list(faults)
        self.source = source

    def __enter__(self) -> "Run":
        return self

    def __exit__(self, *_: object) -> None:
        self.source.close()

    def tables(self, index: int) -> dict[str, Signals]:
        """Return all signals of a trial by name: its devices, ``command``, ``settle``.

        Raises
        ------
        RecordingError
            There is no such trial.
        """
        with self.source.tables(index) as tables:
            return {name: joined(table.pieces()) for name, table in tables.items()}

    def signals(self, index: int) -> dict[str, Signals]:
        """Return what was measured in a trial, by device.

        Raises
        ------
        RecordingError
            There is no such trial.
        """
        return {name: table for name, table in self.tables(index).items() if name not in BESIDE}

    def measured(self, index: int) -> dict[str, Signals]:
        """Return what was commanded (``command``) and what was measured in a trial, by device, tared."""
        tables = {COMMAND: self.command(index), **self.signals(index)}
        return {name: signals.tared() for name, signals in tables.items()}

    def command(self, index: int) -> Signals:
        """Return the commanded joint angles of a trial, rad; without columns where nothing was commanded."""
        command = self.tables(index).get(COMMAND)
        if command is None:
            return Signals(COMMAND, (), (), np.empty(0), np.empty((0, 0)))
        steps = np.diff(command.time_s)
        return replace(command, rate_hz=1 / float(np.median(steps)) if len(steps) else 0.0)

    def settle_curve(self, index: int) -> Signals | None:
        """Return how the bench settled before a trial; None where the experiment does not ask for it."""
        return self.tables(index).get(SETTLE)

    @cached_property
    def devices(self) -> dict[str, dict[str, str]]:
        """Channels with their units, by device, of the first trial that recorded anything."""
        for outcome in self.outcomes:
            with self.source.tables(outcome.index) as tables:
                trial_tables = {name: table for name, table in tables.items() if name not in BESIDE}
            if trial_tables:
                return {
                    name: dict(zip(table.columns, table.units, strict=True))
                    for name, table in trial_tables.items()
                }
        return {}

    def units(self) -> dict[str, str]:
        """Return the units of conditions and objectives by name, as far as the experiment file tells."""
        channels = {
            f"{device}.{column}": unit
            for device, columns in self.devices.items()
            for column, unit in columns.items()
        }
        return known_units(self.experiment_toml, channels)


def open_run(target: Path) -> Run:
    """Open a run, or a recording made elsewhere, for reading; changes nothing on disk.

    Parameters
    ----------
    target
        A run folder, its ``run.h5``, which may have been moved anywhere and renamed, or a recording folder.

    Raises
    ------
    RecordingError
        This is no run, or it cannot be read; or an earlier labrun made it.
    """
    if is_recording(target):
        return _open_recording(target)
    if target.is_dir():
        if (target / SPEC).is_file():
            return _open_folder(target, target)
        if (target / PACKED).is_file():
            return _open_packed(target / PACKED)
        raise RecordingError(
            f"{target} is not a run folder: it has neither {SPEC} nor {PACKED}",
            hint="a run folder is results/<experiment>/<start>-<letters>",
        )
    if not target.is_file():
        raise RecordingError(f"cannot find the run {target}", hint="labrun list shows the runs there are")
    sibling = target.parent / SPEC
    if target.name == PACKED and sibling.is_file():
        packed = _open_packed(target)
        if sibling.read_text() == packed.experiment_toml:
            # its folder may know more: marks and trials since then
            return _open_folder(target.parent, target)
        return packed
    return _open_packed(target)


def open_target(target: str, results: Path) -> Run:
    """Open what a person names: a run or a recording as `labrun.store.locate.find_data` finds it.

    Raises
    ------
    RequestError
        There is none; names what is nearest.
    RecordingError
        It cannot be read, or the recording has faults.
    """
    data = find_data(target, results)
    return open_run(data.absolute() if is_recording(data) else data)


def _open_folder(folder_path: Path, target: Path) -> Run:
    folder = RunFolder(folder_path)
    require_current(folder.journal.events(), folder_path)
    source = TrialSource(folder_path / PACKED, trial_files(folder_path / TRIALS))
    return Run(target, folder.texts(), [*folder.outcomes().values()], source, folder.faults)


def _open_packed(path: Path) -> Run:
    with closing(PackedTrials(path)) as packed:
        return Run(path, packed.texts, [*packed.outcomes.values()], TrialSource(path, {}))


def _open_recording(folder: Path) -> Run:
    recording = read_recording(folder)
    toml = (folder / "recording.toml").read_text(encoding="utf-8")
    texts = RunTexts(
        recording.name,
        folder.absolute().name,
        toml,
        json.dumps({"imported_from": str(folder.absolute())}),
        "",
    )
    return Run(folder, texts, outcomes_of(recording), _Recorded(recording))


def outcomes_of(recording: Recording) -> list[TrialOutcome]:
    """Return an outcome a trial: all are done, and repeats count from 0, where recordings count from 1."""
    return [
        TrialOutcome(
            index,
            dict(trial.condition),
            trial.repeat - 1,
            duration_s=float(trial.time_s[-1]) if len(trial.time_s) else 0.0,
        )
        for index, trial in enumerate(recording.trials)
    ]


class _Recorded:
    """The trials of a recording, each with the signals ``input`` and ``output``; in memory."""

    def __init__(self, recording: Recording) -> None:
        self._recording = recording

    @contextmanager
    def tables(self, index: int) -> Iterator[dict[str, LongSignals]]:
        if not 0 <= index < len(self._recording.trials):
            raise RecordingError(f"recording {self._recording.name} has no trial {index}")
        signals = self._recording.trials[index].signals(self._recording)
        yield {table.name: LongSignals(table[:0], len(table), table.pieces_from) for table in signals}

    def size(self) -> int:
        return sum(trial.source_file.stat().st_size for trial in self._recording.trials)

    def close(self) -> None:
        """Nothing is open."""


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
