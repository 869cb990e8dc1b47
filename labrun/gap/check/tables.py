"""The page of a check: figures, confusion matrix, reliability, and every case."""

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from labrun.gap.check.judging import GOOD, Judged
from labrun.gap.check.text import OF_ONE_KIND, screen, share_text

if TYPE_CHECKING:
    from labrun.gap.check.result import Checked


def page(checked: "Checked") -> str:
    """Return the page, in Markdown."""
    parts = [
        "# Check of the diagnosis\n",
        "```text\n" + screen(checked) + "\n```\n",
        "## Cases that went wrong\n",
        _cases([one for one in checked.judged if not one.good]),
        "## What was said of what\n",
        _confusion(checked),
        "## How sure, and how often right\n",
        _reliability(checked),
        "## Every case\n",
        _cases(checked.judged),
    ]
    return "\n".join(parts)


def _cases(judged: Sequence[Judged]) -> str:
    if not judged:
        return "None.\n"
    header = (
        "case",
        "outcome",
        "hidden",
        "gap",
        "repeats",
        "said",
        "confidence",
        "removed: said",
        "true",
        "s",
    )
    return _table(header, (_row(one) for one in judged))


def _row(one: Judged) -> tuple[str, ...]:
    truth, said, shown = one.truth, one.said, one.shown
    hidden = " + ".join(str(cause) for cause in truth.causes) or "; ".join(truth.forms) or "nothing"
    announced = " + ".join(str(named) for named in said.announced)
    told = f"{said.verdict}: {said.error or announced}" if said.error or announced else said.verdict
    predicted = said.shrinkage
    true = "" if shown is None else _percent(shown.value)
    if shown is not None and shown.value is not None and not shown.counted:
        true = f"({true})"
    return (
        truth.case.removeprefix("case-"),
        f"{one.outcome}, {one.extra} too many" if one.extra and one.outcome in GOOD else one.outcome,
        f"{hidden} ({truth.bench})",
        f"{truth.gap:.2g}",
        str(truth.repeats),
        told,
        ", ".join(f"{named.confidence:.2f}" for named in said.announced),
        ""
        if predicted is None
        else f"{_percent(predicted.value)} [{_percent(predicted.low)}, {_percent(predicted.high)}]",
        true,
        f"{said.seconds:.0f}",
    )


def _confusion(checked: "Checked") -> str:
    """Return what was said of each true effect, most frequent first: a list, where a matrix would be mostly empty."""
    rows = []
    for true, said in checked.scores.confusion.items():
        ordered = sorted(said.items(), key=lambda item: (-item[1], item[0]))
        rows.append((true, str(sum(said.values())), ", ".join(f"{name} {count}" for name, count in ordered)))
    return _table(("hidden", "cases", "said"), rows)


def _reliability(checked: "Checked") -> str:
    bins = checked.scores.calibration.bins
    if not bins:
        return "No cause was announced.\n"
    alone = "" if checked.mixed else f"{OF_ONE_KIND[0].upper()}{OF_ONE_KIND[1:]}.\n\n"
    rows = ((f"{one.low:.1f} to {one.high:.1f}", f"{one.stated:.2f}", share_text(one.right)) for one in bins)
    return alone + _table(("stated confidence", "mean", "right, site included"), rows)


def _table(header: Sequence[str], rows: Iterator[tuple[str, ...]] | Sequence[tuple[str, ...]]) -> str:
    lines = [" | ".join(header), " | ".join("---" for _ in header)]
    lines += [" | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in row) for row in rows]
    return "".join(f"| {line} |\n" for line in lines)


def _percent(value: float | None) -> str:
    return "failed" if value is None else f"{100 * value:.0f} %"
