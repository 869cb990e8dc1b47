"""Every candidate of a diagnosis as a ranked table: verdict, what it removes, its values or how large it can be."""

from collections.abc import Sequence

from labrun.gap.diagnosis import Candidate, Diagnosis
from labrun.report.gap_places import ranked
from labrun.report.html_elements import (
    Content,
    Html,
    element,
    folded,
    joined,
    paragraph,
    section,
    share_bar,
    table,
)
from labrun.report.text import (
    VERDICTS,
    bound_words,
    listed,
    number,
    removes_words,
    value_words,
)

_SHOWN = 10
_COLUMNS = ("", "candidate", "verdict", "removes", "evidence", "size (95 % interval)")


def candidates_section(diagnosis: Diagnosis) -> Html:
    """Return the ranked candidates, and what the columns mean."""
    every = ranked(diagnosis.candidates)
    if not every:
        return section("which", "Which cause", paragraph("No candidate was tried."))
    first = max(_SHOWN, sum(one.verdict in ("cause", "indistinguishable") for one in every))
    rest = every[first:]
    held_out = "conditions its fit did not see" if diagnosis.conditions > 1 else "the data it was fitted to"
    return section(
        "which",
        "Which cause",
        paragraph(_tally(every), class_="lead"),
        _rows(every[:first], 1),
        paragraph(
            f"Removes: share of the recalibrated excess that goes away on {held_out}, refitted together with the "
            "parameters (\u2013: not tried by itself). Evidence: fall of the misfit, in units of the most that noise "
            "alone gives the best of all candidates; only above 1 is it beyond chance. Of what is ruled out, the size "
            "that these data still leave room for.",
            class_="note",
        ),
        folded(f"The other {len(rest)} candidates", _rows(rest, first + 1)) if rest else None,
    )


def _tally(every: Sequence[Candidate]) -> str:
    counts = {verdict: sum(one.verdict == verdict for one in every) for verdict in VERDICTS}
    words = [
        f"{counts['cause']} asked for by the data" if counts["cause"] else "none asked for by the data",
        f"{counts['indistinguishable']} that would explain them as well"
        if counts["indistinguishable"]
        else "",
        f"{counts['ruled-out']} ruled out" if counts["ruled-out"] else "",
        f"{counts['not-visible']} that these data could not show" if counts["not-visible"] else "",
    ]
    return f"{len(every)} candidates: {listed([word for word in words if word])}."


def _rows(candidates: Sequence[Candidate], start: int) -> Html:
    rows: list[list[Content]] = [_row(one, rank) for rank, one in enumerate(candidates, start=start)]
    marked = [n for n, one in enumerate(candidates) if one.verdict == "cause"]
    return table(_COLUMNS, rows, words=(1, 2, 5), marked=marked)


def _row(one: Candidate, rank: int) -> list[Content]:
    name: Content = one.name.words
    return [
        str(rank),
        element("b", name) if one.verdict == "cause" else name,
        _verdict(one),
        _removes(one),
        number(one.evidence, 2),
        _size(one),
    ]


def _verdict(one: Candidate) -> Content:
    same = listed([name.words for name in one.same_as], "or")
    verdict = VERDICTS[one.verdict]
    return (
        f"{verdict}; cannot be told from {same}" if same else verdict.replace("ruled out", "ruled\u00a0out")
    )


def _removes(one: Candidate) -> Content:
    if one.held_out_share is None:
        return joined(["\u2013 ", share_bar(0.0)])
    return joined([f"{removes_words(one.held_out_share)} ", share_bar(max(one.held_out_share, 0.0))])


def _size(one: Candidate) -> Content:
    parts = bound_words(one.upper_bound) if one.verdict == "ruled-out" else []
    parts = parts or ([] if one.verdict == "not-visible" else value_words(one.values))
    if one.remark:
        parts.append(one.remark)
    return "; ".join(parts)
