"""A run that is being executed elsewhere, at one moment."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from labrun.search import Best
from labrun.spec import Value
from labrun.store import Trace, TrialOutcome

State = Literal["starting", "running", "silent", "dead", "stopped", "finished"]
_OF_TRIAL = ("index", "condition", "repeat", "role", "status", "reason", "objectives")
"""What a script is told of each of the last trials."""


@dataclass(frozen=True, slots=True)
class BestYet:
    """The best mean so far: what the search has in hand, and optimistic."""

    condition: dict[str, Value]
    objective: str
    value: float
    trials: int


@dataclass(frozen=True, slots=True)
class Snapshot:
    """A run at one moment.

    Attributes
    ----------
    state
        "silent": nothing was written for long, and nobody knows why; "dead": its process is gone; "stopped": it ended
        early and said so.
    reason
        Why it is not running.
    trials
        Number of trials by status.
    expected
        Number of trials in all; None if nobody can know.
    event, event_utc
        What happened last, in words, and when by the clock of the machine that runs.
    quiet_s
        How long ago that was.
    last_trials
        The latest, newest first.
    best, honest_best
        Best so far, and the confirmed one of a finished run.
    units
        Of conditions and objectives.
    resume
        The command that goes on with a run that came to a stop, or may have.
    """

    run: Path
    experiment: str
    title: str
    state: State
    reason: str
    trials: dict[str, int]
    expected: int | None
    remaining_s: float | None
    event: str
    event_utc: str | None
    quiet_s: float
    last_trials: tuple[TrialOutcome, ...]
    best: BestYet | None
    honest_best: Best | None
    trace: Trace | None
    units: dict[str, str]
    resume: str | None
    notes: tuple[str, ...]

    @property
    def total(self) -> int:
        """Number of trials so far."""
        return sum(self.trials.values())

    def to_json(self) -> dict[str, Any]:
        """Return what `labrun watch --json` prints."""
        return {
            "run": str(self.run),
            "experiment": self.experiment,
            "title": self.title,
            "state": self.state,
            "reason": self.reason,
            "trials": self.trials,
            "expected": self.expected,
            "remaining_s": self.remaining_s,
            "last_event": {"text": self.event, "time_utc": self.event_utc, "ago_s": self.quiet_s},
            "best_so_far": None if self.best is None else self._best_json(self.best),
            "best": None if self.honest_best is None else self.honest_best.to_json(),
            "last_trials": [{key: getattr(trial, key) for key in _OF_TRIAL} for trial in self.last_trials],
            "trace": None if self.trace is None else _trace_json(self.trace),
            "units": self.units,
            "resume": self.resume,
            "notes": list(self.notes),
        }

    def _best_json(self, best: BestYet) -> dict[str, Any]:
        return {
            "parameters": best.condition,
            "objective": {
                "name": best.objective,
                "value": best.value,
                "unit": self.units.get(best.objective, ""),
            },
            "trials": best.trials,
        }


def event_text(event: dict[str, Any] | None) -> str:
    """Say in words what an event of the journal tells."""
    if event is None:
        return "nothing yet"
    kind, index = event["event"], event.get("index")
    reason = event.get("reason") or event.get("cause") or ""
    texts = {
        "created": "the run was made",
        "expected": "the plan stands",
        "baseline": "measured how still the bench is",
        "resumed": "resumed",
        "prepare": f"trial {index}: moves to its start and settles",
        "record": f"trial {index}: recording",
        "safe-pose": f"trial {index}: moves to the safe pose",
        "trial": f"trial {index}: stored, {event.get('status')}",
        "mark": f"trial {index}: {event.get('status')}, {reason}",
        "damaged": f"trial {index}: its file is damaged, it counts as not run",
        "stopped": f"actuators stopped: {reason}",
        "packed": "run.h5 is written",
        "finished": "finished",
        "interrupted": f"interrupted: {reason}",
        "failed": f"failed: {reason}",
        "limit-reached": f"stopped after {event.get('limit')} new trials, as --limit asked",
    }
    return texts.get(kind, str(kind)).splitlines()[0]


def _trace_json(trace: Trace) -> dict[str, Any]:
    return {
        "trial": trace.index,
        "channel": trace.channel,
        "unit": trace.unit,
        "samples": len(trace.values),
        "from_s": float(trace.time_s[0]),
        "to_s": float(trace.time_s[-1]),
        "minimum": float(trace.values.min()),
        "mean": float(trace.values.mean()),
        "maximum": float(trace.values.max()),
        "whole": trace.whole,
    }
