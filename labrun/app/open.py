"""A stored run in a notebook: ``run = labrun.open("fin-params")``, ``run.trials``, ``run.signals("wrench")``."""

import tomllib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import RecordingError
from labrun.spec import condition_text
from labrun.store import frames, layout
from labrun.store.folder import SPEC
from labrun.store.locate import find_run
from labrun.store.reading import open_run
from labrun.store.recorded_tables import RecordedTables, outcomes_of
from labrun.store.recording import is_recording, read_recording
from labrun.store.table import known_units
from labrun.store.trial import TrialOutcome

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from labrun.search.result import Best
    from labrun.spec import Experiment


def open(target: str | Path, results: str | Path = "results") -> "OpenRun":  # noqa: A001 - labrun.open, like h5py's and zarr's
    """Open a stored run, or a recording made elsewhere, to look at its data. Changes nothing on disk.

    Parameters
    ----------
    target
        An experiment's name (its latest run), a run folder, a ``run.h5``, a run's own name, or a recording folder.
    results
        Where runs are.

    Returns
    -------
    OpenRun
        Samples are read when asked for.

    Raises
    ------
    RequestError
        There is no such run, or it cannot be read; says what there is.
    """
    folder = Path(target).expanduser()
    if is_recording(folder):
        recording = read_recording(folder)
        toml = (folder / "recording.toml").read_text(encoding="utf-8")
        outcomes, tables = outcomes_of(recording), RecordedTables(recording)
        return OpenRun(folder, recording.name, folder.name, toml, outcomes, tables)
    run = open_run(find_run(str(target), Path(results)))
    return OpenRun(run.path, run.name, run.identifier, run.experiment_toml, run.outcomes, run.sources)


class OpenRun:
    """A stored run as tables. Made by `labrun.open`.

    Attributes
    ----------
    path
        The run folder, ``run.h5`` or recording folder that was opened.
    name
        The experiment's name.
    identifier
        The run's own name, ``<UTC start>-<4 letters>``.
    experiment_toml
        The experiment file with all defaults; of a recording, its ``recording.toml``.
    """

    def __init__(
        self,
        path: Path,
        name: str,
        identifier: str,
        experiment_toml: str,
        outcomes: Sequence[TrialOutcome],
        source: frames.Source,
    ) -> None:
        self.path = path
        self.name = name
        self.identifier = identifier
        self.experiment_toml = experiment_toml
        self._outcomes = outcomes
        self._source = source

    @cached_property
    def devices(self) -> dict[str, dict[str, str]]:
        """Channels with their units, by device: ``run.devices["wrench"]["force_x"]`` is ``"N"``.

        Those of the first trial that recorded anything.
        """
        with self._source as source:
            for outcome in self._outcomes:
                with source.tables(outcome.index) as tables:
                    found = {name: tables[name].columns for name in tables.names if name not in layout.BESIDE}
                if found:
                    return {
                        name: {item.name: item.unit for item in columns if item.name not in layout.TIMES}
                        for name, columns in found.items()
                    }
        return {}

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of conditions and objectives, as far as the experiment file tells."""
        channels = {
            f"{device}.{channel}": unit
            for device, table in self.devices.items()
            for channel, unit in table.items()
        }
        return known_units(self.experiment_toml, channels)

    @cached_property
    def trials(self) -> "pd.DataFrame":
        """One row a trial, by the trial's index: conditions, repeat, status, objectives, role, reason, times.

        In the units of the experiment file; ``trials.attrs["units"]`` has those of the columns. Rejected and failed
        trials are there too, with their reason: ``run.trials.query("status == 'done'")`` leaves them out.
        """
        return frames.trials_frame(self._outcomes, self.units)

    def signals(self, device: str, trial: int | None = None, *, tared: bool = True) -> "xr.Dataset":
        """Return what a device measured, in SI units, with ``units`` on every variable.

        Parameters
        ----------
        device
            Its name in the experiment file; ``"command"`` for the commanded joint angles (rad), ``"settle"`` for how
            the bench came to rest.
        trial
            Index of one trial, whose samples stand over ``time_s``. Without it all samples of all trials stand one
            after the other over ``sample``, with ``trial_index`` and ``time_s`` beside them.
        tared
            Without the offset that was found just before the recording, on the devices whose tare the experiment asks
            for: as the objectives and figures see it. False gives the values as they came, like ``run.h5``. Of one
            trial, the attribute ``tare`` tells the offset.

        Returns
        -------
        xarray.Dataset
            All in memory. Of a run that is larger than that, take trials one by one, or the lazy
            ``xarray.open_dataset(run.h5, group=device)``.

        Raises
        ------
        RecordingError
            There is no such device or trial; names what there is.
        """
        if trial is None:
            indices = [outcome.index for outcome in self._outcomes]
            return frames.run_dataset(device, indices, self._source, tared=tared)
        return frames.trial_dataset(device, int(trial), self._source, tared=tared)

    @cached_property
    def experiment(self) -> "Experiment":
        """What was run, as its file says.

        Raises
        ------
        RecordingError
            This is a recording made elsewhere, which has no experiment file.
        """
        from labrun.spec import loads_experiment

        if not self._has_experiment:
            raise RecordingError(f"{self.path} is a recording: it has no experiment file")
        return loads_experiment(self.experiment_toml, self.name, plugins=False).experiment

    @cached_property
    def best(self) -> "Best | None":
        """The honest best with its interval; None without a goal, before the end, or of a run.h5 alone."""
        from labrun.search.result import stored_result

        folder = self.path if self.path.is_dir() else self.path.parent
        if self.path.is_file() and not (folder / SPEC).is_file():
            return None  # what lies beside a run.h5 that was moved need not be its own
        result = stored_result(folder)
        return None if result is None else result.best

    @property
    def _has_experiment(self) -> bool:
        return "kind" in tomllib.loads(self.experiment_toml)

    def __len__(self) -> int:
        return len(self._outcomes)

    def __repr__(self) -> str:
        statuses = [outcome.status for outcome in self._outcomes]
        counts = ", ".join(f"{statuses.count(status)} {status}" for status in dict.fromkeys(statuses))
        conditions = dict.fromkeys(name for outcome in self._outcomes for name in outcome.condition)
        objectives = dict.fromkeys(name for outcome in self._outcomes for name in outcome.objectives)
        rows = [("trials", f"{len(statuses)}: {counts}" if statuses else "none yet")]
        rows.append(("conditions", ", ".join(_with_unit(name, self.units) for name in conditions)))
        rows.append(("objectives", ", ".join(_with_unit(name, self.units) for name in objectives)))
        for device, channels in self.devices.items():
            rows.append(
                ("signals", f"{device}: {', '.join(_with_unit(name, channels) for name in channels)}")
            )
        if self.best is not None:
            best = self.best
            rows.append(
                (
                    "best",
                    f"{best.objective_name} = {best.value:.4g} {best.unit} at {condition_text(best.parameters)}",
                )
            )
        rows.append(("path", str(self.path)))
        lines = [f"  {label:<12}{text}" for label, text in rows if text]
        return "\n".join([f"<labrun run of {self.name}, {self.identifier}>", *lines])


def _with_unit(name: str, units: Mapping[str, str]) -> str:
    return f"{name} ({units[name]})" if units.get(name) else name
