"""What the loops themselves record: a stream beside those of the sensors."""

from collections.abc import Mapping, Sequence

import numpy as np

from labrun.control.loop import LoopRecord
from labrun.control.protocol import Feedback
from labrun.devices import Channel, Samples
from labrun.spec import LOOP_CHANNELS, Experiment, loop_channel
from labrun.toml import unit_of

_OF_FEEDBACK = ("reference", "feedback", "error")


def channels_of(experiment: Experiment, feedbacks: Mapping[str, Feedback]) -> tuple[Channel, ...]:
    """Return the channels of the loops' stream: five of each loop, and the timing of the steps."""
    found = []
    for name, feedback in feedbacks.items():
        table = experiment.track.loops[name] if experiment.track is not None else None
        variable = "" if table is None else variable_unit(experiment, table.drives)
        for quantity in LOOP_CHANNELS:
            unit = feedback.unit if quantity in _OF_FEEDBACK else variable
            found.append(Channel(loop_channel(name, quantity), unit or "1"))
    return (*found, Channel("latency_s", "s"), Channel("late_s", "s"), Channel("missed", "1"))


def variable_unit(experiment: Experiment, variable: str) -> str:
    """Return the unit of a variable: as [units] says, else as the key of the gait that takes it as it stands."""
    if variable in experiment.units:
        return experiment.units[variable]
    for keys in experiment.gait.joints.values():
        for key, expression in keys.items():
            if expression.text.strip() == variable:
                return unit_of(key) or ""
    return ""


def samples_of(
    time_s: float,
    records: Sequence[LoopRecord],
    latency_s: float,
    late_s: float,
    *,
    missed: bool,
    skipped: int,
) -> Samples:
    """Return one step as a sample; steps that were skipped before it count as lost."""
    row = [
        value
        for item in records
        for value in (item.reference, item.feedback, item.error, item.drive, item.requested)
    ]
    at = np.array([time_s])
    return Samples(at, at, np.array([[*row, latency_s, late_s, float(missed)]]), lost=skipped)
