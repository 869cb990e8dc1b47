"""What the commands beside a diagnosis answer, in lines: a fresh test, two units, planned trials, an opened seal."""

from collections.abc import Mapping
from typing import Any

from labrun.blind import Compared, Revealed
from labrun.gap import FreshTest, Name, Prediction, ResampledNumber, UnitComparison, UnitDifference
from labrun.gap.next import TrialPlan
from labrun.report.gap_words import estimate_words
from labrun.report.text import (
    aligned,
    condition_text,
    counted,
    duration_text,
    listed,
    number,
    percent,
    spaced,
    unit_text,
)


def fresh_text(found: FreshTest) -> str:
    """Return one line per output and horizon: the model, the one it came from, and by how much the error changed."""
    lines = [f"{found.model} on {found.data}: {counted(found.trials, 'trial')}"]
    if found.warm_up_samples:
        lines.append(
            f"root mean square error; states fitted to the {found.warm_up_samples} samples before each prediction, "
            "nothing else fitted"
        )
    rows = [_row(one) for one in found.predictions]
    head = ["output", "ahead", found.model if found.before != found.model else "corrected"]
    if found.before:
        head += [found.before if found.before != found.model else "as it was", "change"]
    lines += aligned([head, *[row[: len(head)] for row in rows]])
    return "\n".join([*lines, *(f"note: {one}" for one in found.notes)])


def _row(one: Prediction) -> list[str]:
    ahead = "whole trial" if one.horizon_s is None else f"{one.horizon_s:g} s"
    before = "" if one.before is None else estimate_words(one.before)
    return [spaced(one.output), ahead, estimate_words(one.error), before, _change(one.ratio)]


def _change(ratio: ResampledNumber | None) -> str:
    """Return by how much the error fell or grew, ``-80 % [-84 %, -75 %]``; that it is open where it is."""
    if ratio is None:
        return ""
    if not ratio.low < 1.0 < ratio.high:
        ends = f"[{_signed(ratio.low)}, {_signed(ratio.high)}]"
        return f"{_signed(ratio.value)} {ends}"
    return f"no difference told ({number(ratio.low, 2)} to {number(ratio.high, 2)} times)"


def _signed(ratio: float) -> str:
    return f"{'+' if ratio > 1 else '-'}{percent(abs(ratio - 1.0))}"


_HEADINGS = {
    "differs": "differs",
    "same": "same",
    "open": "cannot be told",
    "both lack": "in both, not in the model",
}


def units_text(found: UnitComparison) -> str:
    """Return the verdict as a sentence, then a line for every parameter and size."""
    differing = found.differing
    lines = [_sentence(found)]
    rows = [
        [
            "" if place and found.differences[place - 1].verdict == one.verdict else _HEADINGS[one.verdict],
            _words(one),
            number(one.first, 4),
            number(one.second, 4) if one.verdict == "differs" else "",
            estimate_words(one.change, prefix=False),
            _relative(one),
        ]
        for place, one in enumerate(found.differences)
    ]
    if rows:
        lines += aligned([["", "", "first", "second", "change [95 %]", ""], *rows])
    lines += [
        f"note: {_words(one)}: {listed(one.or_else, 'or')} would explain as much"
        for one in differing
        if one.or_else
    ]
    return "\n".join([*lines, *(f"note: {one}" for one in found.notes)])


def _sentence(found: UnitComparison) -> str:
    if not found.differing:
        return f"No parameter or effect differs beyond noise between {found.first} and {found.second}."
    named = listed(list(dict.fromkeys(one.name.words for one in found.differing)))
    verb = "differs" if len({one.name for one in found.differing}) == 1 else "differ"
    share = (
        ""
        if found.share is None
        else f"; that is {percent(found.share)} of what differing parameters could explain"
    )
    return f"Between {found.first} and {found.second}, {named} {verb}{share}."


def _words(one: UnitDifference) -> str:
    return (
        spaced(one.parameter)
        if one.name.kind == "parameter"
        else f"{spaced(one.parameter)} of {one.name.words}"
    )


def _relative(one: UnitDifference) -> str:
    """Return the interval of the change in per cent, of what there is in the first unit to change."""
    if one.first == 0.0:
        return ""
    ends: ResampledNumber = one.change
    low, high = sorted((ends.low / one.first, ends.high / one.first))
    return f"{percent(low)} to {percent(high)}"


def plan_text(found: TrialPlan) -> str:
    """Return the trials, then a line for every effect."""
    seen = [one for one in found.visible if one.size is not None]
    lines = [
        f"{counted(len(found.trials), 'trial')}, {counted(found.repeats, 'repeat')} of each, about "
        f"{duration_text(found.time_s)} of rig time, of {counted(found.looked_at, 'trial')} inside the limits: "
        f"{len(seen)} of {counted(len(found.visible), 'effect')} would be visible"
    ]
    lines += [
        f"trial {place}  {condition_text(one.condition)}" for place, one in enumerate(found.trials, start=1)
    ]
    noise = ", ".join(
        f"{spaced(name)} {number(one.value)} {unit_text(one.unit)}".rstrip()
        for name, one in found.noise.items()
    )
    lines.append(f"noise    {noise} (standard deviation of one trial)")
    rows = [["visible from", "", "best in", "but looks like"]]
    for one in seen:
        size = one.size
        if size is not None:
            words = f"{spaced(one.parameter)} {number(size.value)} {unit_text(size.unit)}".rstrip()
            alike = [name.words for name in one.alike]
            rows.append([one.name.words, words, f"trial {one.best + 1}", listed(alike, "or")])
    lines += aligned(rows) if seen else []
    hidden = [one for one in found.visible if one.size is None]
    if hidden:
        lines += aligned([["not visible in any of them", ""], *[[one.name.words, one.why] for one in hidden]])
    lines += [f"note: {one}" for one in found.notes]
    if found.file is not None:
        lines += [f"wrote    {found.file}", f"next     labrun run {found.file}"]
    return "\n".join(lines)


def compared_text(compared: Compared) -> str:
    """Return verdict and truth under each other, then what the seal says of itself."""
    hidden, seal = _hidden_lines(compared.revealed), _seal_lines(compared.revealed)
    sizes = [f"sizes     {text}" for text in compared.sizes]
    return "\n".join(
        [f"said      {_said(compared.stored)}", *hidden, f"score     {compared.score}", *sizes, *seal]
    )


def _hidden_lines(revealed: Revealed) -> list[str]:
    return [f"hidden    {one}" for one in revealed.hidden] or ["hidden    nothing"]


def _seal_lines(revealed: Revealed) -> list[str]:
    before = revealed.opened_before
    return [
        f"sealed    {revealed.sealed_at}, sha256 {revealed.sha256[:16]}, unbroken",
        f"opened    before, {len(before)} times, first {before[0]}" if before else "opened    never before",
    ]


def _said(stored: Mapping[str, Any]) -> str:
    causes = stored.get("causes", [])
    if not causes:
        return {"no-gap": "no gap", "not-in-library": "something that is not in the library"}.get(
            str(stored["verdict"]), str(stored["verdict"])
        )
    return "; ".join(_cause(cause) for cause in causes)


def _cause(cause: Mapping[str, Any]) -> str:
    name = str(Name(cause["effect"], cause["site"], cause["kind"]))
    others = [str(Name(one["effect"], one["site"], one["kind"])) for one in cause["indistinguishable_from"]]
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
