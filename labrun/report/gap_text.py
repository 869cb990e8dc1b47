"""A diagnosis in a terminal: what its page says, in at most 20 lines."""

import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path

from rich.text import Text

from labrun.gap import Diagnosis, RatedCandidate
from labrun.report.gap_words import (
    VERDICTS,
    bound_words,
    data_words,
    hot_spots,
    ranked,
    removes_words,
    times_noise,
    value_words,
)
from labrun.report.text import listed, p_words, percent, short_time_text

MOST_LINES = 20
_MARGIN = 9
_NARROWEST = 40
_LEAST_FOR_SENTENCES = 1
_RIVALS = 2
_CUT = " \u2026"


def gap_lines(diagnosis: Diagnosis, width: int, files: Mapping[str, Path] | None = None) -> list[Text]:
    """Return a diagnosis as at most 20 lines.

    Parameters
    ----------
    diagnosis
        What was found.
    width
        Columns of the terminal; no line but a path is longer.
    files
        What was written, by a word for it; a line each, three at most.
    """
    width = max(width, _NARROWEST)
    room = width - _MARGIN
    head = _fitted([diagnosis.sentence], width, 3)
    fixed = [("gap", _gap(diagnosis, room)), ("where", [_cut(line, room) for line in _where(diagnosis)])]
    if diagnosis.rest is not None:
        fixed.append(("rest", _fitted([diagnosis.rest.sentence], room, 3)))
    written = [(label, [str(path)]) for label, path in (files or {}).items()]
    data = [
        _cut(f"{data_words(diagnosis)}; {short_time_text(diagnosis.seconds)}, seed {diagnosis.seed}", room)
    ]
    left = MOST_LINES - len(head) - sum(len(lines) for _, lines in fixed) - len(written) - len(data)
    which = _which(diagnosis, room, left - 2 * _LEAST_FOR_SENTENCES)
    limits, then = _shared(diagnosis, room, left - len(which))
    sections = [*fixed, ("which", which), ("limits", limits), ("next", then), ("data", data), *written]
    lines = [Text(line, style="bold") for line in head]
    for label, body in sections:
        for number, line in enumerate(body):
            text = Text(f"{label if number == 0 else '':<{_MARGIN}}", style="dim")
            lines.append(text.append(line, style="not dim"))
    return lines


def _gap(diagnosis: Diagnosis, room: int) -> list[str]:
    gap, share = diagnosis.gap, diagnosis.shrinkage
    steps = f"{times_noise(gap.raw)} as stated > {times_noise(gap.recalibrated)} recalibrated"
    if diagnosis.causes:
        steps += f" > {times_noise(gap.after)} with the cause{'s' * (len(diagnosis.causes) > 1)}"
    steps += f"; noise floor {times_noise(gap.floor)}"
    lines = [_first_that_fits([f"{steps} (noise of one trial = 1)", steps], room)]
    if share is not None and diagnosis.causes:
        unseen = "unseen conditions" if diagnosis.conditions > 1 else "withheld blocks of time"
        ends = f"{percent(share.low)} to {percent(share.high)}"
        lines.append(_cut(f"{percent(share.value)} of it closes on {unseen} (90 % interval {ends})", room))
    if diagnosis.learnable is not None:
        lines.append(_cut(diagnosis.learnable.sentence, room))
    return lines


def _where(diagnosis: Diagnosis) -> list[str]:
    if diagnosis.verdict == "no-gap":
        return []
    return [
        f"{percent(spot.share)}  {spot.text}" + (f" ({p_words(spot.p)})" if spot.p is not None else "")
        for spot in hot_spots(diagnosis.where)
    ]


def _which(diagnosis: Diagnosis, room: int, most: int) -> list[str]:
    """Return the causes, the rivals next to them as far as there is room, and how many there are besides."""
    lines: list[str] = []
    for cause in diagnosis.causes:
        same = [name.words for name in cause.indistinguishable_from]
        told = f"{cause.name.words}, confidence {percent(cause.confidence)}"
        told += f", or {listed(same, 'or')}" if same else ""
        values = "; ".join(value_words(cause.values))
        lines += _fitted([f"{told}: {values}" if values else told], room, 2)
    rivals = [one for one in ranked(diagnosis.candidates) if one.verdict != "cause"]
    lines = lines if len(lines) <= most - 1 else [*lines[: most - 2], _cut(f"{lines[most - 2]} \u2026", room)]
    named = min(_RIVALS, most - 1 - len(lines))
    lines += [_rival(one, room) for one in rivals[:named]]
    rest = rivals[named:]
    if rest:
        counts = [
            f"{sum(one.verdict == verdict for one in rest)} {words}"
            for verdict, words in VERDICTS.items()
            if any(one.verdict == verdict for one in rest)
        ]
        lines.append(_cut(f"and {listed(counts)}", room))
    return lines


def _rival(one: RatedCandidate, room: int) -> str:
    text = f"{one.name.words}: {VERDICTS[one.verdict]}"
    if one.held_out_share is not None:
        removes = removes_words(one.held_out_share)
        text += f", removes {removes}" if removes[0].isdigit() or removes[0] == "<" else f", {removes}"
    bounds = bound_words(one.upper_bound) if one.verdict == "ruled-out" else []
    return _first_that_fits([f"{text}; {bounds[0]}", text] if bounds else [text], room)


def _first_that_fits(lines: Sequence[str], room: int) -> str:
    return next((line for line in lines if len(line) <= room), _cut(lines[-1], room))


def _shared(diagnosis: Diagnosis, room: int, lines: int) -> tuple[list[str], list[str]]:
    """Return limitations and what to do next, sharing so many lines; the first of each is never left out."""
    wanted = len(_fitted(diagnosis.what_next, room, lines))
    then = min(wanted, max(lines // 2, _LEAST_FOR_SENTENCES)) if diagnosis.limitations else wanted
    limits = _fitted(diagnosis.limitations, room, max(lines - then, 0))
    return limits, _fitted(diagnosis.what_next, room, lines - len(limits))


def _fitted(sentences: Sequence[str], room: int, lines: int) -> list[str]:
    """Return sentences wrapped into at most so many lines; what does not fit is cut, and said to be."""
    wrapped = [line for text in sentences for line in textwrap.wrap(text, room, break_on_hyphens=False)]
    if len(wrapped) <= lines:
        return wrapped
    kept = wrapped[:lines]
    if kept:
        kept[-1] = _cut(f"{kept[-1]} \u2026", room)
    return kept


def _cut(line: str, room: int) -> str:
    return line if len(line) <= room else f"{line[: room - 1].rstrip(_CUT)}{_CUT[1]}"
