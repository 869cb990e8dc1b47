"""What `labrun show` tells of a recording made elsewhere."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from labrun.spec import Value, condition_key
from labrun.store import imported_channels

if TYPE_CHECKING:
    from rich.console import Console

    from labrun.store import Run


@dataclass(frozen=True, slots=True)
class ChannelFindings:
    """One channel: whether it is an ``"input"`` or an ``"output"``, its unit, and its median rate over the trials."""

    name: str
    kind: str
    unit: str
    rate_hz: float


@dataclass(frozen=True, slots=True)
class ConditionFindings:
    """The trials of one condition: how many, how many of them count, and how long the shortest and longest are."""

    condition: Mapping[str, Value]
    trials: int
    done: int
    shortest_s: float
    longest_s: float


@dataclass(frozen=True, slots=True)
class RecordingFindings:
    """A recording made elsewhere.

    Attributes
    ----------
    run
        Where it is: the run it was imported as, or the recording folder itself.
    experiment
        Its name.
    imported_from
        The folder it was read from.
    finished
        Whether all of it is there: an import is whole or absent.
    trials
        Their number.
    duration_s
        Of all trials together.
    faults
        What was found damaged on disk.
    """

    run: Path
    experiment: str
    imported_from: Path
    finished: bool
    trials: int
    duration_s: float
    channels: list[ChannelFindings]
    conditions: list[ConditionFindings]
    faults: list[str]

    def to_json(self) -> dict[str, Any]:
        """Return everything, JSON-ready."""
        return {
            "run": str(self.run),
            "experiment": self.experiment,
            "kind": "recording",
            "finished": self.finished,
            "imported_from": str(self.imported_from),
            "trials": self.trials,
            "duration_s": self.duration_s,
            "channels": [asdict(channel) for channel in self.channels],
            "conditions": [asdict(condition) for condition in self.conditions],
            "faults": self.faults,
        }

    def print(self, console: "Console | None" = None) -> None:
        """Print it for a person; to standard output if no console is given."""
        from labrun.report.tables import print_recording

        print_recording(self, console)


def is_imported(run: "Run") -> bool:
    """Tell whether a run was recorded elsewhere: it has a ``recording.toml`` in place of an experiment file."""
    return bool(imported_channels(run.experiment_toml))


def recording_findings(run: "Run") -> RecordingFindings:
    """Read what there is in a recording.

    Parameters
    ----------
    run
        For which `is_imported` holds.
    """
    rates: dict[str, list[float]] = {"input": [], "output": []}
    groups: dict[object, list[int]] = {}
    for number, outcome in enumerate(run.outcomes):
        groups.setdefault(condition_key(outcome.condition), []).append(number)
        for name, stream in run.signals(outcome.index).items():
            rates.setdefault(name, []).append(stream.rate_hz)
    median_hz = {kind: float(np.median(found)) if found else 0.0 for kind, found in rates.items()}
    origin = Path(run.provenance.get("imported_from", run.path))
    conditions = []
    for numbers in groups.values():
        trials = [run.outcomes[number] for number in numbers]
        durations_s = [trial.duration_s for trial in trials]
        done = sum(trial.status == "done" for trial in trials)
        conditions.append(
            ConditionFindings(trials[0].condition, len(trials), done, min(durations_s), max(durations_s))
        )
    return RecordingFindings(
        run=run.path,
        experiment=run.name,
        imported_from=origin,
        finished=True,
        trials=len(run.outcomes),
        duration_s=sum(outcome.duration_s for outcome in run.outcomes),
        channels=[
            ChannelFindings(name, table["kind"], table["unit"], median_hz[table["kind"]])
            for name, table in imported_channels(run.experiment_toml).items()
        ],
        conditions=conditions,
        faults=list(run.faults),
    )
