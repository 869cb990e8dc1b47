"""Terminal text of `labrun gap`: a diagnosis in at most 20 lines, and the answers of its other commands."""

import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.text import Text

from labrun.blind import Compared
from labrun.gap import (
    Diagnosis,
    FreshTest,
    Name,
    Prediction,
    ResampledNumber,
    UnitComparison,
    UnitDifference,
)
from labrun.gap.next import TrialPlan
from labrun.report.gap_words import (
    HEADLINES,
    closes_words,
    data_words,
    estimate_words,
    hot_spots,
    ladder_lines,
    reference_words,
    rest_words,
    value_words,
)
from labrun.report.text import (
    aligned,
    condition_text,
    counted,
    duration_text,
    listed,
    number,
    p_words,
    percent,
    short_time_text,
    spaced,
    unit_text,
)

MOST_LINES = 20
_HEAD_LINES = 5
_MARGIN = 9
_NARROWEST = 40
_LEAST_FOR_SENTENCES = 1
_RIVALS, _LADDERS = 3, 3
_FAR_OPEN = 100.0
"""Times its value from which the end of an interval says nothing but that the data say nothing."""
_UNCHANGED = 0.005
"""Change of an error, as a part of it, that rounds to 0 %."""
_CUT = " \u2026"


def gap_lines(diagnosis: Diagnosis, width: int, files: Mapping[str, Path] | None = None) -> list[Text]:
    """Return a diagnosis as at most 20 lines: the answer, the ladder of errors, the causes, and the rest.

    Parameters
    ----------
    width
        Columns of the terminal; no line but a path is longer.
    files
        What was written, by a word for it; a line each, three at most.
    """
    width = max(width, _NARROWEST)
    room = width - _MARGIN
    head = _fitted([diagnosis.sentence], width, _HEAD_LINES)
    if not diagnosis.complete:
        head.append(_cut("Stopped early: this is the best answer so far.", width))
    fixed = [
        ("error", _fitted(ladder_lines(diagnosis)[:_LADDERS], room, 2 * _LADDERS)),
        ("causes", _causes(diagnosis, room)),
        ("rest", _fitted([rest_words(diagnosis)], room, 2)),
    ]
    if diagnosis.law is not None:
        fixed.append(("law", _fitted([diagnosis.law.sentence], room, 3)))
    written = [(label, [str(path)]) for label, path in (files or {}).items()]
    data = [
        _cut(f"{data_words(diagnosis)}; {short_time_text(diagnosis.seconds)}, seed {diagnosis.seed}", room)
    ]
    left = MOST_LINES - len(head) - sum(len(lines) for _, lines in fixed) - len(written) - len(data)
    where = [_cut(line, room) for line in _where(diagnosis)][: max(min(3, left - 3), 0)]
    others = _others(diagnosis, room) if left - len(where) > 2 * _LEAST_FOR_SENTENCES else []
    limits, then = _shared(diagnosis, room, left - len(where) - len(others))
    sections = [
        *fixed, ("others", others), ("where", where), ("limits", limits), ("next", then), ("data", data), *written,
    ]  # fmt: skip
    lines = [Text(line, style="bold") for line in head]
    for label, body in _trimmed(sections, MOST_LINES - len(head), room):
        for index, line in enumerate(body):
            text = Text(f"{label if index == 0 else '':<{_MARGIN}}", style="dim")
            lines.append(text.append(line, style="not dim"))
    return lines


def _trimmed(sections: Sequence[tuple[str, list[str]]], most: int, room: int) -> list[tuple[str, list[str]]]:
    """Return sections of at most `most` lines together: the longest are cut first, and said to be; none to nothing."""
    bodies = [list(body) for _, body in sections]
    while sum(map(len, bodies)) > most and len(longest := max(bodies, key=len)) > 1:
        longest.pop()
        longest[-1] = _cut(f"{longest[-1].removesuffix(_CUT)}{_CUT}", room)
    return [(label, body) for (label, _), body in zip(sections, bodies, strict=True)]


def _causes(diagnosis: Diagnosis, room: int) -> list[str]:
    """Return each cause with its sizes, its share of the gap and its rivals, on at most three lines."""
    lines = []
    for cause in diagnosis.causes:
        values = "; ".join(value_words(cause.values))
        parts = [f"{cause.name.words}{': ' + values if values else ''} {reference_words(cause)}".rstrip()]
        parts.append(closes_words(cause))
        if cause.rivals:
            parts.append(f"rivals: {listed([name.words for name in cause.rivals[:_RIVALS]])}")
        lines += _fitted(["; ".join(parts)], room, 3)
    return lines


def _others(diagnosis: Diagnosis, room: int) -> list[str]:
    """Return how many other candidates became what."""
    counts = Counter(row.verdict for row in diagnosis.candidates if row.verdict != "cause")
    words = {"rival": "rivals", "not-needed": "not needed", "excluded": "excluded above a size"}
    text = listed([f"{count} {words.get(verdict, 'not visible')}" for verdict, count in counts.items()])
    return [_cut(text, room)] if text else []


def _where(diagnosis: Diagnosis) -> list[str]:
    if diagnosis.verdict == "no-gap":
        return []
    return [
        f"{percent(spot.share)}  {spot.text}" + (f" ({p_words(spot.p)})" if spot.p is not None else "")
        for spot in hot_spots(diagnosis.where)
    ]


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
    """Return a line that is no longer than there is room, cut behind a word and said to be."""
    if len(line) <= room:
        return line
    words = line[: room - 1].rpartition(" ")[0] or line[: room - 2]
    return f"{words.rstrip(f'{_CUT},;')}{_CUT}"


def fresh_text(test: FreshTest) -> str:
    """Return one line per output and horizon: the model, the one it came from, and by how much the error changed."""
    lines = [f"{test.model} on {test.data}: {counted(test.trials, 'trial')}"]
    if test.warm_up_samples:
        lines.append(
            f"root mean square error; states fitted to the {test.warm_up_samples} samples before each prediction, "
            "nothing else fitted"
        )
    rows = [_row(prediction) for prediction in test.predictions]
    head = ["output", "ahead", test.model if test.before != test.model else "corrected"]
    if test.before:
        head += [test.before if test.before != test.model else "as it was", "change"]
    lines += aligned([head, *[row[: len(head)] for row in rows]])
    return "\n".join([*lines, *(f"note: {note}" for note in test.notes)])


def _row(prediction: Prediction) -> list[str]:
    ahead = "whole trial" if prediction.horizon_s is None else f"{prediction.horizon_s:g} s"
    before = "" if prediction.before is None else estimate_words(prediction.before, like=prediction.error)
    return [
        spaced(prediction.output),
        ahead,
        estimate_words(prediction.error),
        before,
        _change(prediction.ratio),
    ]


def _change(ratio: ResampledNumber | None) -> str:
    """Return by how much the error fell or grew, ``-80 % [-84 %, -75 %]``; that it is open where it is."""
    if ratio is None:
        return ""
    if max(abs(ratio.low - 1.0), abs(ratio.high - 1.0)) < _UNCHANGED:
        return "unchanged"
    if not ratio.low < 1.0 < ratio.high:
        ends = f"[{_signed(ratio.low)}, {_signed(ratio.high)}]"
        return f"{_signed(ratio.value)} {ends}"
    return f"no significant change ({number(ratio.low, 2)} to {number(ratio.high, 2)} times)"


def _signed(ratio: float) -> str:
    return f"{'+' if ratio > 1 else '-'}{percent(abs(ratio - 1.0))}"


_HEADINGS = {
    "differs": "differs",
    "same": "same",
    "open": "cannot be told",
    "both lack": "in both, not in the model",
}


def units_text(comparison: UnitComparison) -> str:
    """Return the verdict as a sentence, then a line for every parameter and size."""
    differing = comparison.differing
    lines = [_sentence(comparison)]
    rows = [
        [
            ""
            if index and comparison.differences[index - 1].verdict == difference.verdict
            else _HEADINGS[difference.verdict],
            _words(difference),
            number(difference.first, 4),
            number(difference.second, 4) if difference.verdict == "differs" else "",
            *(
                ("not told by these data", "")
                if _untold(difference)
                else (estimate_words(difference.change, prefix=False), _relative(difference))
            ),
        ]
        for index, difference in enumerate(comparison.differences)
    ]
    if rows:
        lines += aligned([["", "", "first", "second", "change [95 %]", "of the first"], *rows])
    lines += [
        f"note: {_words(difference)}: {listed(difference.or_else, 'or')} would explain as much"
        for difference in differing
        if difference.or_else
    ]
    doubtful = [
        difference
        for difference in comparison.differences
        if difference.verdict == "open" and not _untold(difference)
    ]
    if any(not difference.change.low <= 0.0 <= difference.change.high for difference in doubtful):
        lines.append(
            "note: an interval without zero is not enough: a difference also has to improve predictions of conditions "
            "that the fit has not seen"
        )
    return "\n".join([*lines, *(f"note: {note}" for note in comparison.notes)])


def _untold(difference: UnitDifference) -> bool:
    """Tell whether the data leave a change open by far more than there is to change."""
    return max(abs(difference.change.low), abs(difference.change.high)) > _FAR_OPEN * max(
        abs(difference.first), abs(difference.second)
    )


def _sentence(comparison: UnitComparison) -> str:
    if not comparison.differing:
        return (
            f"No parameter or effect differs beyond noise between {comparison.first} and {comparison.second}."
        )
    named = listed(list(dict.fromkeys(difference.name.words for difference in comparison.differing)))
    verb = "differs" if len({difference.name for difference in comparison.differing}) == 1 else "differ"
    share = (
        ""
        if comparison.share is None
        else f"; that is {percent(comparison.share)} of what differing parameters could explain"
    )
    return f"Between {comparison.first} and {comparison.second}, {named} {verb}{share}."


def _words(difference: UnitDifference) -> str:
    return (
        spaced(difference.parameter)
        if difference.name.kind == "parameter"
        else f"{spaced(difference.parameter)} of {difference.name.words}"
    )


def _relative(difference: UnitDifference) -> str:
    """Return the interval of the change in per cent, of what there is in the first unit to change."""
    if difference.first == 0.0:
        return ""
    ends: ResampledNumber = difference.change
    low, high = sorted((ends.low / difference.first, ends.high / difference.first))
    return f"{percent(low)} to {percent(high)}"


def trial_plan_text(plan: TrialPlan) -> str:
    """Return the trials, then a line for every effect."""
    seen = [effect for effect in plan.visible if effect.size is not None]
    lines = [
        f"{counted(len(plan.trials), 'trial')}, {counted(plan.repeats, 'repeat')} of each, about "
        f"{duration_text(plan.time_s)} of rig time, of {counted(plan.looked_at, 'trial')} inside the limits: "
        f"{len(seen)} of {counted(len(plan.visible), 'effect')} would be visible"
    ]
    lines += [
        f"trial {index}  {condition_text(trial.condition)}"
        for index, trial in enumerate(plan.trials, start=1)
    ]
    noise = ", ".join(
        f"{spaced(name)} {number(sd.value)} {unit_text(sd.unit)}".rstrip() for name, sd in plan.noise.items()
    )
    lines.append(f"noise    {noise} (standard deviation of one trial)")
    rows = [["visible from", "", "best in", "but looks like"]]
    for effect in seen:
        size = effect.size
        if size is not None:
            words = f"{spaced(effect.parameter)} {number(size.value)} {unit_text(size.unit)}".rstrip()
            alike = [name.words for name in effect.alike]
            rows.append([effect.name.words, words, f"trial {effect.best + 1}", listed(alike, "or")])
    lines += aligned(rows) if seen else []
    hidden = [effect for effect in plan.visible if effect.size is None]
    if hidden:
        lines += aligned(
            [["not visible in any of them", ""], *[[effect.name.words, effect.why] for effect in hidden]]
        )
    lines += [f"note: {note}" for note in plan.notes]
    if plan.file is not None:
        lines += [f"wrote    {plan.file}", f"next     labrun run {plan.file}"]
    return "\n".join(lines)


def compared_text(compared: Compared) -> str:
    """Return verdict and truth under each other, then what the seal says of itself."""
    seal = compared.revealed
    before = seal.opened_before
    lines = [
        f"said      {_said(compared.stored)}",
        *(f"hidden    {name}" for name in seal.hidden or ("nothing",)),
        f"score     {compared.score}",
        *(f"sizes     {text}" for text in compared.sizes),
        f"sealed    {seal.sealed_at}, sha256 {seal.sha256[:16]}, unbroken",
        f"opened    before, {len(before)} times, first {before[0]}" if before else "opened    never before",
    ]
    return "\n".join(lines)


def _said(stored: Mapping[str, Any]) -> str:
    causes = stored.get("causes", [])
    if not causes:
        return HEADLINES.get(str(stored["verdict"]), str(stored["verdict"]))
    return "; ".join(_cause(cause) for cause in causes)


def _cause(cause: Mapping[str, Any]) -> str:
    name = str(Name(cause["effect"], cause["site"], cause["kind"]))
    others = [
        str(Name(other["effect"], other["site"], other["kind"])) for other in cause["indistinguishable_from"]
    ]
    if others:
        name += f" (or {listed(others, 'or')})"
    values = ", ".join(_value(key, value) for key, value in cause["values"].items())
    return f"{name}: {values}" if values else name


def _value(name: str, value: Mapping[str, Any]) -> str:
    low, high = value["ci95"]
    if value["value"] is None or low is None or high is None:
        return f"{spaced(name)} = {'not known' if value['value'] is None else number(value['value'])}"
    estimate = ResampledNumber(value["value"], low, high, value["unit"])
    return f"{name} = {estimate_words(estimate, prefix=False)}"
