"""How far a model predicts fresh data, as people read it."""

from labrun.gap import FreshTest, Prediction, ResampledNumber
from labrun.report.gap_words import estimate_words
from labrun.report.text import aligned, counted, number, percent, spaced


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
