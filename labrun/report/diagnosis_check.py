"""A check of the diagnosis as people read it: the figures on one screen, and a page with every case."""

from collections.abc import Iterator
from pathlib import Path

from labrun.blind import GOOD, STRENGTHS, Checked, Judged, Scores, Share
from labrun.report.page import render
from labrun.report.text import counted
from labrun.store import replace_durably

_TO_REACH = {"0.5 to 1": "75 %", "1 to 3": "90 %", "3 and above": "95 %"}
_LABEL = 25
_MANY = 50
"""From so many cases on a tenth of a percent is more than rounding: 3.4 % is not at most 3 %."""
_OF_ONE_KIND = "what a stated confidence is worth shows only where kinds of cases are mixed"


def check_text(checked: Checked) -> str:
    """Return everything a person has to know before looking into the table of cases.

    Kinds that no case is of are left out.
    """
    scores = checked.scores
    kinds = ", ".join(f"{count} {kind}" for kind, count in scores.kinds.items())
    head = [
        f"{counted(scores.cases, 'case')}: {kinds}",
        checked.use,
        f"seal {checked.seal[:16]}... was printed first; every answer is the one that was sealed",
    ]
    wrong = sum(not one.good for one in checked.judged)
    blocks = [head, list(_naming(scores)), list(_restraint(scores)), list(_data(scores))]
    blocks.append(list(_numbers(scores, checked.mixed)))
    if len(checked.programmes) > 1:
        blocks[-1].append(f"different code diagnosed these cases: {', '.join(checked.programmes)}")
    told = f"every case, and the {wrong} that went wrong" if wrong else "every case (none went wrong)"
    blocks.append([f"{told}: {checked.folder / 'check.md'}"])
    return "\n\n".join("\n".join(block) for block in blocks if block)


def check_page(checked: Checked) -> str:
    """Return the page, in Markdown."""
    confusion = []  # a list, most frequent first, where a matrix would be mostly empty
    for true, said in checked.scores.confusion.items():
        ordered = sorted(said.items(), key=lambda item: (-item[1], item[0]))
        confusion.append((true, sum(said.values()), ", ".join(f"{name} {count}" for name, count in ordered)))
    bins = checked.scores.calibration.bins
    return render(
        "check.md.j2",
        {
            "told": check_text(checked),
            "wrong": [_row(one) for one in checked.judged if not one.good],
            "every": [_row(one) for one in checked.judged],
            "confusion": confusion,
            "bins": [
                (f"{one.low:.1f} to {one.high:.1f}", f"{one.stated:.2f}", _share_text(one.right))
                for one in bins
            ],
            "mixed": checked.mixed,
            "of_one_kind": _OF_ONE_KIND,
        },
    )


def write_check_page(checked: Checked) -> Path:
    """Write the page of a check as ``check.md`` beside its cases; return its path."""
    path = checked.folder / "check.md"
    replace_durably(path, check_page(checked).encode())
    return path


def _share_text(share: Share) -> str:
    """Return a share with its interval: "18 of 20: 90 % [68, 99]"."""
    value, interval = share.value, share.ci95
    if value is None or interval is None:
        return "no such case"
    places = 1 if share.of >= _MANY else 0
    low, high = (f"{100 * bound:.{places}f}" for bound in interval)
    return f"{share.hits} of {share.of}: {100 * value:.{places}f} % [{low}, {high}]"


def _naming(scores: Scores) -> Iterator[str]:
    if scores.kinds.get("effect"):
        yield "cause named, alone or in a set of two, by the true gap in units of one trial's noise"
        for strength in STRENGTHS:
            yield _line(f"  {strength}", _share_text(scores.named[strength]), _TO_REACH.get(strength, ""))
    if scores.sites.of:
        yield _line("site right among them", _share_text(scores.sites), "97 %")
    for strength, counts in scores.pairs.items():
        told = [
            f"{words} {counts[name]}"
            for name, words in (
                ("both-named", "both named"),
                ("one-named", "one"),
                ("none-named", "none"),
                ("error", "not diagnosed"),
            )
            if name in counts
        ]
        yield _line(f"pairs, {strength}", ", ".join(told))
    if scores.pair_sites.of:
        yield _line("site right in pairs", _share_text(scores.pair_sites))
    if scores.kinds.get("parameter"):
        yield _line("parameter far off", _share_text(scores.parameters))
    if scores.set_sizes:
        sizes = ", ".join(f"{count} with {size}" for size, count in scores.set_sizes.items())
        yield _line("candidates per cause", f"{sizes} (alone: 1)")


def _restraint(scores: Scores) -> Iterator[str]:
    if scores.kinds.get("control"):
        yield _line("false alarms in controls", _of_diagnosed(scores.false_alarms), "at most 3 %")
    outside = scores.kinds.get("outside", 0)
    if outside:
        yield "not in the library: recognised, by the true gap"
        for strength in STRENGTHS:
            yield _line(f"  {strength}", _share_text(scores.recognised[strength]))
        yield _line("  0.5 and above", _share_text(scores.recognised_from_half), "95 %")
    if outside < scores.cases:
        label = "  claimed wrongly" if outside else "wrongly not in library"
        yield _line(label, _of_diagnosed(scores.wrongly_unknown), "at most 5 %")
        yield _line("more effects than hidden", _of_diagnosed(scores.extra))


def _data(scores: Scores) -> Iterator[str]:
    if scores.by_data:
        yield "came out as one would wish, by kind of data (the weakest gaps included)"
    for data, share in scores.by_data.items():
        yield _line(f"  {data}", _share_text(share))


def _of_diagnosed(share: Share) -> str:
    return _share_text(share) if share.of else "none was diagnosed"


def _numbers(scores: Scores, mixed: bool) -> Iterator[str]:
    told = sum(one.right.of for one in scores.calibration.bins)
    error = scores.calibration.error
    if error is None:
        yield _line("causes announced", "none")
    elif mixed:
        chance = scores.calibration.error_by_chance
        yield _line("error of confidence", f"{error:.3f} ({told} causes; by chance {chance:.3f})", "0.05")
    if scores.sizes_covered.of:
        yield _line("sizes in 95 % intervals", _share_text(scores.sizes_covered), "90 to 98 %")
    shrinkage = scores.shrinkage
    if shrinkage.median_difference is not None:
        points = (
            f"{100 * shrinkage.median_difference:.1f} points ({counted(len(shrinkage.differences), 'case')})"
        )
        yield _line("shrinkage off by (median)", points, "5 points")
        yield _line("  within its 90 % interval", _share_text(shrinkage.covered), "85 to 95 %")
    left_out = (
        (shrinkage.too_small, "with too small a gap"),
        (shrinkage.failed, "not computed"),
        (shrinkage.unpredicted, "not predicted"),
    )
    if any(count for count, _ in left_out):
        words = ", ".join(f"{count} {why}" for count, why in left_out if count)
        yield _line("shrinkage left out", words)
    if scores.seconds:
        took = scores.seconds
        text = f"median {took['median']:.0f} s, longest {took['longest']:.0f} s"
        yield _line("one diagnosis", text)
    yield _line("not diagnosed (errors)", ", ".join(scores.errors) or "none")


def _line(label: str, value: str, reach: str = "") -> str:
    told = f"{label:<{_LABEL}}  {value}"
    return f"{told:<66}to reach: {reach}" if reach else told


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


def _percent(value: float | None) -> str:
    return "failed" if value is None else f"{100 * value:.0f} %"
