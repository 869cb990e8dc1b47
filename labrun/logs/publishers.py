"""Two writers of one topic that tell different values of the same joint: noticed by jumps there and back."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from labrun.arrays import FloatArray
from labrun.logs.findings import Finding, Question, Statement
from labrun.logs.streams import Stream

_LEAST_SAMPLES = 20
_RETURNS = 0.1
"""Part of the samples from which a signal goes to the other writer's value and back."""
_WITHIN = 0.2
"""Steps of one writer are less than this part of the jumps between two."""
_STEPS = 20.0
"""A jump is so many of the signal's least steps: an encoder that flickers between two counts is one writer."""


def separate_publishers(stream: Stream, chosen: Mapping[str, int]) -> tuple[Stream, list[Finding]]:
    """Return a stream without the values of other writers than the chosen ones, and what is in doubt.

    `chosen`: topic -> number of its writer, from 1, as the question lists them.
    """
    findings: list[Finding] = []
    columns = list(stream.columns)
    number = chosen.get(stream.name)
    is_listed = False
    for stem in dict.fromkeys(column.stem for column in columns if column.stem):
        own = [column for column in columns if column.stem == stem and column.role in ("position", "command")]
        labels = next(
            (guess for column in own if (guess := find_writers(column.values, stream.publisher)) is not None),
            None,
        )
        if labels is None:
            continue
        writers = [int(label) for label in np.unique(labels[labels >= 0])]
        spans = [_span(own[0].values[labels == label]) for label in writers]
        moving = int(np.argmax([high - low for low, high, _ in spans]))
        kept = moving if number is None or not 1 <= number <= len(writers) else number - 1
        if not is_listed:
            listed = "; ".join(
                f"{index}: {count} messages, {stem} {low:.4g} to {high:.4g}"
                for index, (low, high, count) in enumerate(spans, 1)
            )
            text = f"{stream.name}: {len(writers)} writers tell different values of {stem} ({listed})"
            if number is None or not 1 <= number <= len(writers):
                findings.append(
                    Question(
                        text, f"--publisher {stream.name}={moving + 1}", f"--publisher {stream.name}=NUMBER"
                    )
                )
            else:
                lost = int((labels != writers[kept]).sum())
                findings.append(Statement(f"{text}; {number} is taken, and {lost} messages are left out"))
            is_listed = True
        others = labels != writers[kept]
        columns = [
            replace(column, values=np.where(others, np.nan, column.values)) if column.stem == stem else column
            for column in columns
        ]
    return replace(stream, columns=tuple(columns)), findings


def _span(values: FloatArray) -> tuple[float, float, int]:
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max()), len(finite)) if len(finite) else (0.0, 0.0, 0)


def find_writers(signal: FloatArray, publisher: NDArray[np.int64] | None) -> NDArray[np.int64] | None:
    """Return who wrote each sample of a signal, -1 for none; None where one writer explains all of them.

    `publisher`: who sent each message, where the log says so.
    """
    rows = np.flatnonzero(np.isfinite(signal))
    values = signal[rows]
    if len(values) < _LEAST_SAMPLES or not _returns(values):
        return None
    labels = np.full(len(signal), -1)
    named = None if publisher is None else publisher[rows]
    for guess in (named, _constant(values), _tracks(values)):
        if guess is not None and len(np.unique(guess)) > 1 and _apart(values, guess):
            labels[rows] = guess
            return labels
    return None


def _constant(values: FloatArray) -> NDArray[np.int64] | None:
    """Return which samples are exactly the value that comes most often, as of a writer that sends zeros."""
    levels, counts = np.unique(values, return_counts=True)
    if counts.max() < _RETURNS * len(values):
        return None
    return np.asarray(values != levels[np.argmax(counts)], dtype=np.int64)


def _returns(values: FloatArray) -> bool:
    """Tell whether a signal often goes away and comes back to where it was within three samples."""
    away = np.abs(np.diff(values))
    back = np.full(len(values) - 1, np.inf)
    for later in (1, 2, 3):
        gap = np.abs(values[1 + later :] - values[: -1 - later])
        back[: len(gap)] = np.minimum(back[: len(gap)], gap)
    return float(np.mean((away > 0.0) & (back < _WITHIN * away))) > _RETURNS


def _tracks(values: FloatArray) -> NDArray[np.int64]:
    """Return which of two courses each sample continues: that whose last value is nearer."""
    steps = np.abs(np.diff(values))
    jump = 0.5 * float(np.quantile(steps, 0.95))
    last = [float(values[0]), float(values[1 + int(np.argmax(steps > jump))])]
    labels = np.zeros(len(values), dtype=np.int64)
    for row, value in enumerate(values):
        label = int(abs(value - last[1]) < abs(value - last[0]))
        labels[row], last[label] = label, float(value)
    return labels


def _apart(values: FloatArray, labels: NDArray[np.int64]) -> bool:
    """Tell whether writers step far less than what lies between them."""
    changes = labels[1:] != labels[:-1]
    if changes.mean() < _RETURNS:
        return False
    between = float(np.quantile(np.abs(np.diff(values))[changes], 0.9))  # the two may meet now and then
    within = [np.abs(np.diff(values[labels == label])) for label in np.unique(labels)]
    steps = np.concatenate(within)
    nonzero = steps[steps > 0]
    smallest = float(np.quantile(nonzero, 0.05)) if len(nonzero) else between
    return float(np.quantile(steps, 0.9)) < _WITHIN * between and between > _STEPS * smallest
