"""What differs between two units, as people read it."""

from labrun.gap import ResampledNumber, UnitComparison, UnitDifference
from labrun.report.gap_words import estimate_words
from labrun.report.text import aligned, listed, number, percent, spaced

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
