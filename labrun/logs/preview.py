"""What of a log would be read, channel by channel: the table that a person checks before anything is written."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from labrun.logs.cleaning import GAP_PERIODS
from labrun.logs.matching import Match

_JUMP = 10.0
"""A step between two samples is a jump if it is so many times what 99 % of the steps stay below."""

_COARSE = 0.5
"""A signal has steps if it takes fewer different values than this part of its samples."""


@dataclass(frozen=True, slots=True)
class ChannelPreview:
    """One channel of the model, and what of the log it is.

    Attributes
    ----------
    column
        Of the log; "none" where the log has none.
    unit, why
        What the column is in, and how that is known.
    rate_hz
    lowest, highest
        In the model's unit.
    gaps, jumps
        How often more than five periods are missing; how often the value jumps.
    resolution
        Least difference of two values, in the model's unit, where values come again; 0 where hardly any does, and for
        a constant.
    without
        Samples of its stream that hold no number, or are in no trial.
    """

    channel: str
    column: str
    unit: str = ""
    why: str = ""
    rate_hz: float = 0.0
    lowest: float = 0.0
    highest: float = 0.0
    model_unit: str = ""
    samples: int = 0
    gaps: int = 0
    jumps: int = 0
    resolution: float = 0.0
    without: int = 0

    @classmethod
    def of(cls, match: Match, used: int) -> "ChannelPreview":
        """Return what a match would give, of which `used` samples are in trials."""
        if match.column is None or match.stream is None:
            return cls(match.wanted.channel, "none", model_unit=match.wanted.unit)
        rows = np.isfinite(match.column.values) & np.isfinite(match.stream.time_s)
        values, time_s = match.in_si()[rows], match.stream.time_s[rows]
        if len(values) < 2:
            return cls(match.wanted.channel, match.column.name, match.unit, match.why, samples=len(values))
        steps = np.diff(time_s)
        period = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
        changes = np.abs(np.diff(values))
        usual = float(np.quantile(changes, 0.99))
        levels = np.unique(np.round(values, 9 - int(np.floor(np.log10(np.ptp(values) or 1.0)))))
        steps_between = np.diff(levels) if len(levels) < _COARSE * len(values) else np.empty(0)
        return cls(
            match.wanted.channel, match.column.name, match.unit, match.why, 1.0 / period if period else 0.0,
            float(values.min()), float(values.max()), match.wanted.unit, len(values),
            int((steps > GAP_PERIODS * period).sum()) if period else 0,
            int((changes > _JUMP * usual).sum()) if usual else 0,
            float(np.min(steps_between)) if len(steps_between) else 0.0,
            max(len(match.column.values) - used, 0),
        )  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """Return the fields by name."""
        return asdict(self)

    def cells(self) -> list[str]:
        """Return the row of the table, a cell for each of `HEADER`."""
        if not self.samples:
            return [self.channel, self.column, *[""] * (len(HEADER) - 2)]
        return [
            self.channel, self.column, self.unit, f"{self.rate_hz:.4g}",
            f"{self.lowest:.4g} to {self.highest:.4g} {self.model_unit}", str(self.gaps), str(self.jumps),
            f"{self.resolution:.2g}" if self.resolution else "fine", f"{self.without} of {self.samples}", self.why,
        ]  # fmt: skip


HEADER = (
    "channel",
    "column",
    "unit",
    "Hz",
    "span",
    "gaps",
    "jumps",
    "resolution",
    "left out",
    "why this unit",
)


def previews(
    logs: Sequence[Sequence[Match]], names: Sequence[str], used: Sequence[int]
) -> list[ChannelPreview]:
    """Return the table of all logs, one log after another; `used`: how many samples of each are in trials."""
    rows = []
    for matches, name, count in zip(logs, names, used, strict=True):
        for match in matches:
            row = ChannelPreview.of(match, count)
            rows.append(row if len(logs) == 1 else replace(row, column=f"{name}: {row.column}"))
    return rows
