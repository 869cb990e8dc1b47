"""A stored run in a notebook: ``run = labrun.open("fin-params")``, ``run.trials``, ``run.signals("wrench")``."""

import tomllib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from labrun.errors import RecordingError
from labrun.experiment import condition_text
from labrun.notebook import as_html
from labrun.store import SPEC, Run, open_target, run_dataset, trial_dataset, trials_frame

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

    from labrun.experiment import Experiment
    from labrun.search import Best


def open(target: str | Path, results: str | Path = "results") -> "OpenRun":  # noqa: A001 - labrun.open, like h5py's and zarr's
    """Open a stored run, or a recording made elsewhere, to look at its data. Changes nothing on disk.

    Parameters
    ----------
    target
        An experiment's name (its latest run), a run folder, a ``run.h5``, a run's own name, or a recording.
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
    return OpenRun(open_target(str(target), Path(results)))


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

    def __init__(self, run: Run) -> None:
        self._run = run
        self.path = run.path
        self.name = run.name
        self.identifier = run.identifier
        self.experiment_toml = run.experiment_toml

    @cached_property
    def devices(self) -> dict[str, dict[str, str]]:
        """Channels with their units, by device: ``run.devices["wrench"]["force_x"]`` is ``"N"``.

        Those of the first trial that recorded anything.
        """
        return self._run.devices

    @cached_property
    def units(self) -> dict[str, str]:
        """Units of conditions and objectives, as far as the experiment file tells."""
        return self._run.units()

    @cached_property
    def trials(self) -> "pd.DataFrame":
        """One row a trial, by the trial's index: conditions, repeat, status, objectives, role, reason, times.

        In the units of the experiment file; ``trials.attrs["units"]`` has those of the columns. Rejected and failed
        trials are there too, with their reason: ``run.trials.query("status == 'done'")`` leaves them out.
        """
        return trials_frame(self._run.outcomes, self.units)

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
            return run_dataset(self._run, device, tared=tared)
        return trial_dataset(self._run, device, int(trial), tared=tared)

    @cached_property
    def experiment(self) -> "Experiment":
        """What was run, as its file says.

        Raises
        ------
        RecordingError
            This is a recording made elsewhere, which has no experiment file.
        """
        from labrun.experiment import loads_experiment

        if not self._has_experiment:
            raise RecordingError(f"{self.path} is a recording: it has no experiment file")
        return loads_experiment(self.experiment_toml, self.name, plugins=False).experiment

    @cached_property
    def best(self) -> "Best | None":
        """The honest best with its interval; None without a goal, before the end, or of a run.h5 alone."""
        from labrun.search import stored_result

        folder = self.path if self.path.is_dir() else self.path.parent
        if self.path.is_file() and not (folder / SPEC).is_file():
            return None  # what lies beside a run.h5 that was moved need not be its own
        result = stored_result(folder)
        return None if result is None else result.best

    @property
    def _has_experiment(self) -> bool:
        return "kind" in tomllib.loads(self.experiment_toml)

    def __len__(self) -> int:
        return len(self._run.outcomes)

    def _repr_html_(self) -> str:
        return as_html(repr(self))

    def __repr__(self) -> str:
        statuses = [outcome.status for outcome in self._run.outcomes]
        counts = ", ".join(f"{statuses.count(status)} {status}" for status in dict.fromkeys(statuses))
        conditions = dict.fromkeys(name for outcome in self._run.outcomes for name in outcome.condition)
        objectives = dict.fromkeys(name for outcome in self._run.outcomes for name in outcome.objectives)
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
