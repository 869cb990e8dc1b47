"""Whether the topics of a log have one clock: offsets and rates of stamps against their receipt by the recorder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from labrun.arrays import FloatArray
from labrun.logs.findings import Finding, Question, Statement
from labrun.logs.matching import Match
from labrun.logs.streams import Stream

StampSource = Literal["own", "receipt"]
OFFSET_S = 0.005
"""Offsets and drifts above this are told (chosen: half a period at 100 Hz)."""
_OTHER_CLOCK_S = 0.5
"""Stamps further than this from their receipt are of another clock (chosen: a network's delay is far below)."""
_BLOCKS = 20
_SIGNIFICANT = 4.0
_MOST_BEND_S = 0.1
"""Stamps that leave a straight line against their receipt by more were set anew while the log ran."""


@dataclass(frozen=True)
class _Line:
    """``stamp = receipt * rate + offset_s``, and how far blocks of stamps lie from it at most."""

    rate: float
    offset_s: float
    span_s: float
    bend_s: float
    scatter_s: float

    @property
    def drift_s(self) -> float:
        """By how much the clock gains over the log; 0 where that cannot be told from a varying delay."""
        gained = (self.rate - 1.0) * self.span_s
        return gained if abs(gained) > max(OFFSET_S, _SIGNIFICANT * self.scatter_s) else 0.0


def align_clocks(
    matches: Sequence[Match], source: StampSource | None = None
) -> tuple[list[Match], list[Finding]]:
    """Return the matches with all streams on one clock, that of what is measured, and what was found.

    Parameters
    ----------
    source
        Which stamps a person wants: the messages' own, as they are, or those of receipt.
    """
    streams = list({id(match.stream): match.stream for match in matches if match.stream is not None}.values())
    findings: list[Finding] = []
    moved: dict[int, Stream] = {}
    if source == "receipt":
        for stream in streams:
            if not stream.received and stream.receipt_s is not None:
                moved[id(stream)] = replace(stream, time_s=stream.receipt_s, received=True)
                findings.append(Statement(f"{stream.name}: stamps of receipt are used, as --stamps says"))
    elif source is None:
        moved = _aligned(streams, matches, findings)
    made = [
        match if match.stream is None else replace(match, stream=moved.get(id(match.stream), match.stream))
        for match in matches
    ]
    return made, findings


def _aligned(
    streams: Sequence[Stream], matches: Sequence[Match], findings: list[Finding]
) -> dict[int, Stream]:
    lines = {id(stream): line for stream in streams if (line := _line(stream)) is not None}
    for stream in streams:
        line = lines.get(id(stream))
        if line is not None and line.bend_s > _MOST_BEND_S:
            findings.append(
                Question(
                    f"{stream.name}: its stamps leave a straight line against their receipt by {line.bend_s:.3g} s, as "
                    "of a clock that was set while the log ran",
                    proposal="--stamps receipt",
                    answers="--stamps own",
                )
            )
    drifting = {key: line for key, line in lines.items() if line.drift_s}
    if drifting:
        return _on_one_clock(streams, matches, lines, findings)
    moved: dict[int, Stream] = {}
    for stream in streams:
        line = lines.get(id(stream))
        if line is None or stream.receipt_s is None:
            continue
        apart = float(np.nanmedian(stream.receipt_s - stream.time_s))
        if abs(apart) > _OTHER_CLOCK_S:
            text = f"its stamps are of a clock {apart:+.3f} s from the recorder's, and were shifted by that"
            findings.append(Statement(f"{stream.name}: {text}"))
            moved[id(stream)] = replace(stream, time_s=stream.time_s + apart)
    findings += _offset([moved.get(id(stream), stream) for stream in streams])
    return moved


def _on_one_clock(
    streams: Sequence[Stream], matches: Sequence[Match], lines: Mapping[int, _Line], findings: list[Finding]
) -> dict[int, Stream]:
    """Put all streams on the clock of the one that measures most: each by its line against the recorder's clock."""
    base = max(streams, key=lambda stream: _measured(stream, matches))
    own = lines.get(id(base), _Line(1.0, 0.0, 0.0, 0.0, 0.0))
    moved: dict[int, Stream] = {}
    for stream in streams:
        line = lines.get(id(stream))
        if line is not None and line.drift_s:
            findings.append(
                Statement(
                    f"{stream.name}: its clock runs at {line.rate:.6g} of the recorder's, {line.drift_s:+.3g} s over "
                    f"{line.span_s:.4g} s"
                )
            )
        if stream is base:
            continue
        rate = 1.0 if line is None else line.rate
        if abs(rate - own.rate) * own.span_s <= OFFSET_S and line is not None:
            continue  # the same clock as what is measured
        recorder_s = stream.time_s if line is None else (stream.time_s - line.offset_s) / line.rate
        moved[id(stream)] = replace(stream, time_s=own.rate * recorder_s + own.offset_s)
        findings.append(
            Statement(f"{stream.name}: its stamps are put on the clock of {base.name} by their rates")
        )
    return moved


def _measured(stream: Stream, matches: Sequence[Match]) -> tuple[int, int]:
    outputs = sum(match.stream is stream and match.wanted.kind == "output" for match in matches)
    return outputs, len(stream.time_s)


def _line(stream: Stream) -> _Line | None:
    """Return the line of stamps against receipt, through medians of blocks: delays vary, and some are long."""
    if stream.received or stream.receipt_s is None or len(stream.time_s) < 2 * _BLOCKS:
        return None
    whole = np.isfinite(stream.time_s) & np.isfinite(stream.receipt_s)
    receipt, stamps = stream.receipt_s[whole], stream.time_s[whole]
    if len(receipt) < 2 * _BLOCKS or np.ptp(receipt) == 0.0:
        return None
    at = np.array([float(np.median(block)) for block in np.array_split(receipt, _BLOCKS)])
    lead = np.array([float(np.median(block)) for block in np.array_split(stamps - receipt, _BLOCKS)])
    slope, offset = (float(value) for value in np.polyfit(at - at[0], lead, 1))
    residual: FloatArray = lead - (offset + slope * (at - at[0]))
    scatter = float(np.std(residual)) * 2.0 * np.sqrt(3.0 / _BLOCKS)
    span = float(np.ptp(receipt))
    return _Line(1.0 + slope, offset - slope * float(at[0]), span, float(np.max(np.abs(residual))), scatter)


def _offset(streams: Sequence[Stream]) -> list[Finding]:
    """Return a sentence if the stamps of one stream lie further before their receipt than those of another."""
    leads = sorted(
        (0.0 if stream.received else float(np.nanmedian(stream.receipt_s - stream.time_s)), stream.name)
        for stream in streams
        if stream.receipt_s is not None
    )
    if not leads or leads[-1][0] - leads[0][0] <= OFFSET_S:
        return []
    (least, early), (most, late) = leads[0], leads[-1]
    return [
        Statement(
            f"stamps of {late} lie {1e3 * most:.1f} ms before their receipt, those of {early} {1e3 * least:.1f} ms: "
            f"the {1e3 * (most - least):.1f} ms between are the way to the recorder or a clock that is off, which the "
            "log cannot tell; stamps are taken as they are"
        )
    ]
