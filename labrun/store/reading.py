"""A stored run, read back: the same from a run folder and from ``run.h5`` alone."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from labrun.devices.samples import Channel
from labrun.errors import RecordingError
from labrun.store import layout, packed_file, table
from labrun.store.folder import PACKED, SPEC, TRIALS, RunFolder
from labrun.store.journal import parse_events
from labrun.store.packed_file import RunTexts
from labrun.store.sources import TrialSources
from labrun.store.trial import SettleCurve, Stream, TrialOutcome
from labrun.store.trial_file import trial_files


class Run:
    """One stored run. Samples are read from disk when asked for.

    Attributes
    ----------
    path
        The run folder, or the ``run.h5`` that was opened.
    name
        The experiment's name.
    identifier
        The run's own name, ``<UTC start>-<4 letters>``.
    experiment_toml
        The resolved experiment file.
    provenance
        Versions, machine, devices, seed.
    outcomes
        Of every trial in order of execution, later marks applied.
    events
        The journal.
    faults
        What was found damaged, one sentence each.
    """

    def __init__(
        self,
        path: Path,
        texts: RunTexts,
        outcomes: Mapping[int, TrialOutcome],
        sources: TrialSources,
        faults: list[str],
    ) -> None:
        self.path = path
        self.texts = texts
        self.name = texts.experiment
        self.identifier = texts.run
        self.experiment_toml = texts.spec_toml
        self.provenance: dict[str, Any] = json.loads(texts.provenance_json)
        self.outcomes = list(outcomes.values())
        self.events = parse_events(texts.journal_jsonl.encode(), f"journal of {path}")
        self.faults = faults
        self.sources = sources

    def __enter__(self) -> "Run":
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing stays open between two calls."""

    def streams(self, index: int) -> dict[str, Stream]:
        """Return all streams of a trial by device.

        Raises
        ------
        RecordingError
            There is no such trial.
        """
        with self.sources as sources, sources.tables(index) as tables:
            return {name: layout.stream_of(tables[name].read()) for name in tables.devices}

    def stream(self, index: int, name: str) -> Stream:
        """Return the stream of one device in a trial.

        Raises
        ------
        RecordingError
            There is no such trial, or no such device in it; names those there are.
        """
        with self.sources as sources, sources.tables(index) as tables:
            if name not in tables.devices:
                raise RecordingError(
                    f"trial {index} of {self.path} has no device {name!r}",
                    hint=f"recorded were: {', '.join(tables.devices)}",
                )
            return layout.stream_of(tables[name].read())

    def command(self, index: int) -> Stream:
        """Return the commanded joint angles of a trial, rad; without channels where nothing was commanded."""
        with self.sources as sources, sources.tables(index) as tables:
            if layout.COMMAND not in tables.names:
                nothing = np.empty(0)
                return Stream(layout.COMMAND, (), nothing, nothing, nothing, np.empty((0, 0)), rate_hz=0.0)
            command = layout.command_of(tables[layout.COMMAND].read())
        steps = np.diff(command.time_s)
        return Stream(
            layout.COMMAND,
            tuple(Channel(joint, "rad") for joint in command.joints),
            command.time_s,
            command.time_s,
            command.time_s,
            command.angle_rad,
            rate_hz=1 / float(np.median(steps)) if len(steps) else 0.0,
        )

    def settle_curve(self, index: int) -> SettleCurve | None:
        """Return how the bench settled before a trial; None where the experiment does not ask for it."""
        with self.sources as sources, sources.tables(index) as tables:
            if layout.SETTLE not in tables.names:
                return None
            return layout.settle_of(tables[layout.SETTLE].read())

    def units(self) -> dict[str, str]:
        """Return the units of conditions and objectives by name, as far as the experiment file tells."""
        channel_units: dict[str, str] = {}
        if self.outcomes:
            with self.sources as sources, sources.tables(self.outcomes[0].index) as tables:
                channel_units = {
                    f"{name}.{column.name}": column.unit
                    for name in tables.devices
                    for column in tables[name].columns
                }
        return table.known_units(self.experiment_toml, channel_units)


def open_run(target: Path) -> Run:
    """Open a run for reading; changes nothing on disk.

    Parameters
    ----------
    target
        A run folder, or its ``run.h5``, which may have been moved anywhere and renamed.

    Raises
    ------
    RecordingError
        This is no run, or it cannot be read.
    """
    if target.is_dir():
        if (target / SPEC).is_file():
            return _open_folder(target, target)
        if (target / PACKED).is_file():
            return _open_packed(target / PACKED)
        raise RecordingError(
            f"{target} is no run folder: it has neither {SPEC} nor {PACKED}",
            hint="a run folder is results/<experiment>/<start>-<letters>",
        )
    if not target.is_file():
        raise RecordingError(f"there is no run {target}", hint="labrun list shows the runs there are")
    beside = target.parent / SPEC
    if (
        target.name == PACKED
        and beside.is_file()
        and beside.read_text() == packed_file.read_texts(target).spec_toml
    ):
        return _open_folder(target.parent, target)  # its folder may know more: marks and trials since then
    return _open_packed(target)


def _open_folder(folder_path: Path, target: Path) -> Run:
    folder = RunFolder(folder_path)
    outcomes = folder.outcomes()
    sources = TrialSources(folder_path / PACKED, trial_files(folder_path / TRIALS))
    return Run(target, folder.texts(), outcomes, sources, folder.faults)


def _open_packed(path: Path) -> Run:
    texts = packed_file.read_texts(path)
    outcomes = packed_file.read_outcomes(path)
    return Run(path, texts, outcomes, TrialSources(path, {}), [])
