"""What the loops themselves record: a stream beside those of the sensors."""

from collections.abc import Mapping, Sequence
from itertools import chain

import numpy as np

from labrun.control.loop import LoopRecord
from labrun.control.protocol import Feedback
from labrun.devices import Channel, Samples
from labrun.spec import Experiment, LoopTable
from labrun.toml import unit_of


def channels_of(
    experiment: Experiment, loops: Mapping[str, LoopTable], feedbacks: Mapping[str, Sequence[Feedback]]
) -> tuple[Channel, ...]:
    """Return the channels of the loops' stream: those of each loop, and the timing of the steps."""
    found = []
    for name, table in loops.items():
        shape = table.shape
        of_feedback = units_of(feedbacks[name], len(shape.components))
        of_drives = [variable_unit(experiment, variable) for variable in table.drives]
        units = [*3 * of_feedback, *2 * of_drives, *shape.more.values()]
        found += [Channel(c, unit or "1") for c, unit in zip(shape.channels(name), units, strict=True)]
    return (*found, Channel("latency_s", "s"), Channel("late_s", "s"), Channel("missed", "1"))


def units_of(feedbacks: Sequence[Feedback], count: int) -> list[str]:
    """Return the unit of each component of a loop's feedback."""
    return [feedbacks[0].unit] * count if len(feedbacks) == 1 else [one.unit for one in feedbacks]


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
    row = chain.from_iterable(item.row for item in records)
    at = np.array([time_s])
    return Samples(at, at, np.array([[*row, latency_s, late_s, float(missed)]]), lost=skipped)
