"""A check of the diagnosis as people read it: the figures on one screen, and a page with every case."""

from collections.abc import Callable, Iterator
from pathlib import Path

from labrun.blind import STRENGTHS, Checked, Judged, Scored, Scores, Share
from labrun.report.page import render
from labrun.report.text import aligned, counted
from labrun.store import replace_durably

_TO_REACH = {"0.5 to 1": "75 %", "1 to 3": "90 %", "3 and above": "95 %"}
_MANY = 50
"""From so many cases on a tenth of a percent is more than rounding: 3.4 % is not at most 3 %."""
_NONE = "-"
_OF_ONE_KIND = "what a stated confidence is worth shows only where kinds of cases are mixed"

_Cell = Callable[[Scores], str]


def check_text(checked: Checked) -> str:
    """Return everything a person has to know before looking into the table of cases.

    Kinds that no case is of are left out, and figures that no program has.
    """
    scores = checked.scores
    kinds = ", ".join(f"{count} {kind}" for kind, count in scores.kinds.items())
    head = [
        f"{counted(scores.cases, 'case')}: {kinds}",
        checked.use,
        f"seal {checked.seal[:16]}... was printed first; every answer is the one that was sealed",
    ]
    programs = (checked.labrun, *checked.tools)
    rows = []
    for label, to_reach, cell in _figures(checked):
        cells = [cell(program.scores) for program in programs]
        if any(text != _NONE for text in cells):
            rows.append([label, *cells, to_reach])
    foot = []
    if len(checked.programmes) > 1:
        foot.append(f"different code diagnosed these cases: {', '.join(checked.programmes)}")
    wrong = sum(not case.right for case in checked.judged)
    every = f"every case, and the {wrong} that went wrong" if wrong else "every case (none went wrong)"
    foot.append(f"{every}: {checked.folder / 'check.md'}")
    table = aligned([["", *(program.name for program in programs), "to reach"], *rows])
    blocks = [head, [line.rstrip() for line in table], foot]
    return "\n\n".join("\n".join(block) for block in blocks)


def check_page(checked: Checked) -> str:
    """Return the page, in Markdown."""
    bins = checked.scores.calibration.bins
    return render(
        "check.md.j2",
        {
            "told": check_text(checked),
            "wrong": [_row(case) for case in checked.judged if not case.right],
            "every": [_row(case) for case in checked.judged],
            "data": [(data, _share_text(share)) for data, share in checked.scores.by_data.items()],
            "bins": [
                (f"{tenth.low:.1f} to {tenth.high:.1f}", f"{tenth.stated:.2f}", _share_text(tenth.right))
                for tenth in bins
            ],
            "mixed": checked.mixed,
            "of_one_kind": _OF_ONE_KIND,
            "tools": [_tool(tool) for tool in checked.tools],
        },
    )


def write_check_page(checked: Checked) -> Path:
    """Write the page of a check as ``check.md`` in its folder; return its path."""
    path = checked.folder / "check.md"
    replace_durably(path, check_page(checked).encode())
    return path


def _figures(checked: Checked) -> Iterator[tuple[str, str, _Cell]]:
    """Yield label, goal and getter of every figure."""
    with_interval = not checked.tools

    def share(of: Callable[[Scores], Share]) -> _Cell:
        return lambda scores: _share_text(of(scores), with_interval)

    for strength in reversed(STRENGTHS):
        yield f"cause named, G {strength}", _TO_REACH.get(strength, ""), share(_at(strength, "named"))
    for strength in reversed(STRENGTHS):
        yield f"both of a pair named, G {strength}", "", share(_at(strength, "pairs"))
    yield "parameter far off named", "", share(lambda scores: scores.parameters)
    yield "site right among the named", "97 %", share(lambda scores: scores.sites)
    yield "controls blamed", "at most 3 %", share(lambda scores: scores.controls_blamed)
    yield "controls with a gap, no cause", "", share(lambda scores: scores.controls_with_gap)
    for strength in reversed(STRENGTHS):
        yield f"outside the library right, G {strength}", "", share(_at(strength, "outside"))
    yield "outside right, G from 0.5", "95 %", share(lambda scores: scores.outside_from_half)
    yield "rest told there", "", share(lambda scores: scores.rest_told)
    yield "false causes per case", "", _false_causes
    yield "sets of one, two, more", "", _sets
    yield "sizes in 95 % intervals", "90 to 98 %", share(lambda scores: scores.sizes_covered)
    yield "shares in 90 % intervals", "85 to 95 %", share(lambda scores: scores.shares.covered)
    yield "shares left out", "", _shares_left_out
    if checked.mixed:
        yield "error of confidence", "0.05", _confidence
    yield "processor s, median; longest", "", _seconds
    yield "no answer", "", lambda scores: f"{len(scores.unanswered)} of {scores.cases}"


def _at(strength: str, figure: str) -> Callable[[Scores], Share]:
    return lambda scores: getattr(scores, figure)[strength]


def _share_text(share: Share, with_interval: bool = True) -> str:
    """Return a share with its interval: "18 of 20: 90 % [68, 99]"."""
    value, interval = share.value, share.ci95
    if value is None or interval is None:
        return _NONE
    places = 1 if share.of >= _MANY else 0
    low, high = (f"{100 * bound:.{places}f}" for bound in interval)
    text = f"{share.hits} of {share.of}: {100 * value:.{places}f} %"
    return f"{text} [{low}, {high}]" if with_interval else text


def _false_causes(scores: Scores) -> str:
    mean = scores.false_causes_per_case
    return _NONE if mean is None else f"{mean:.2f}"


def _sets(scores: Scores) -> str:
    counts = [scores.set_sizes.get(1, 0), scores.set_sizes.get(2, 0)]
    counts.append(sum(scores.set_sizes.values()) - sum(counts))
    return ", ".join(map(str, counts)) if any(counts) else _NONE


def _confidence(scores: Scores) -> str:
    error, chance = scores.calibration.error, scores.calibration.error_by_chance
    causes = sum(tenth.right.of for tenth in scores.calibration.bins)
    return _NONE if error is None else f"{error:.3f} ({causes} causes; by chance {chance:.3f})"


def _shares_left_out(scores: Scores) -> str:
    if not scores.shares.predicted:
        return _NONE
    left_out = (
        (scores.shares.too_small, "gap too small"),
        (scores.shares.failed, "not computed"),
        (scores.shares.unpredicted, "not predicted"),
    )
    return ", ".join(f"{count} {why}" for count, why in left_out if count) or _NONE


def _seconds(scores: Scores) -> str:
    used = scores.processor_s
    return f"{used['median']:.1f}; {used['longest']:.0f}" if used else _NONE


def _tool(tool: Scored) -> dict[str, object]:
    return {
        "name": tool.name,
        "command": " ".join(tool.command),
        "every": [_row(case) for case in tool.judged],
    }


def _row(case: Judged) -> tuple[str, ...]:
    truth, reply, shown = case.truth, case.reply, case.shown
    hidden = " + ".join(str(cause) for cause in truth.causes) or "; ".join(truth.forms) or "nothing"
    predicted, answer = reply.predicted, reply.answer
    true = "" if shown is None else _percent(shown.value)
    if shown is not None and shown.value is not None and not shown.counted:
        true = f"({true})"
    return (
        truth.case.removeprefix("case-"),
        f"{case.outcome}, {case.false_causes} false" if case.false_causes else case.outcome,
        f"{hidden} ({truth.bench})",
        f"{truth.gap:.2g}",
        str(truth.repeats),
        reply.reason
        if answer is None
        else " + ".join(map(str, case.causes)) or ("a gap" if answer.gap else "no gap"),
        ", ".join(_percent(cause.closes) for cause in case.causes if cause.closes is not None),
        "" if answer is None or answer.rest is None else _percent(answer.rest),
        ", ".join(f"{cause.confidence:.2f}" for cause in case.causes if cause.confidence is not None),
        ""
        if predicted is None
        else f"{_percent(predicted.value)} [{_percent(predicted.low)}, {_percent(predicted.high)}]",
        true,
        f"{reply.processor_s:.1f}",
    )


def _percent(value: float | None) -> str:
    return "failed" if value is None else f"{100 * value:.0f} %"
