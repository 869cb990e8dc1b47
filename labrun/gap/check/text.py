"""The figures of a check on one screen, each beside what it is to reach."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

from labrun.gap.check.cases import STRENGTHS
from labrun.gap.check.shares import Share

if TYPE_CHECKING:
    from labrun.gap.check.result import Checked
    from labrun.gap.check.scoring import Scores

_TO_REACH = {"0.5 to 1": "75 %", "1 to 3": "90 %", "3 and above": "95 %"}
_LABEL = 25
_MANY = 50
"""From so many cases on a tenth of a percent is more than rounding: 3.4 % is not at most 3 %."""
OF_ONE_KIND = "what a stated confidence is worth shows only where kinds of cases are mixed"


def screen(checked: "Checked") -> str:
    """Return everything a person has to know before looking into the table of cases.

    Kinds that no case is of are left out.
    """
    scores = checked.scores
    kinds = ", ".join(f"{count} {kind}" for kind, count in scores.kinds.items())
    head = [
        f"{_cases(scores.cases)}: {kinds}",
        checked.use,
        f"seal {checked.seal[:16]}... was printed first; every answer is the one that was sealed",
    ]
    wrong = sum(not one.good for one in checked.judged)
    blocks = [head, list(_naming(scores)), list(_restraint(scores)), list(_numbers(scores, checked.mixed))]
    if len(checked.programmes) > 1:
        blocks[-1].append(f"different code diagnosed these cases: {', '.join(checked.programmes)}")
    told = f"every case, and the {wrong} that went wrong" if wrong else "every case (none went wrong)"
    blocks.append([f"{told}: {checked.folder / 'check.md'}"])
    return "\n\n".join("\n".join(block) for block in blocks if block)


def share_text(share: Share) -> str:
    """Return a share with its interval: "18 of 20: 90 % [68, 99]"."""
    value, interval = share.value, share.ci95
    if value is None or interval is None:
        return "no such case"
    places = 1 if share.of >= _MANY else 0
    low, high = (f"{100 * bound:.{places}f}" for bound in interval)
    return f"{share.hits} of {share.of}: {100 * value:.{places}f} % [{low}, {high}]"


def _naming(scores: "Scores") -> Iterator[str]:
    if scores.kinds.get("effect"):
        yield "cause named, alone or in a set of two, by the true gap in units of one trial's noise"
        for strength in STRENGTHS:
            yield _row(f"  {strength}", share_text(scores.named[strength]), _TO_REACH.get(strength, ""))
    if scores.sites.of:
        yield _row("site right among them", share_text(scores.sites), "97 %")
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
        yield _row(f"pairs, {strength}", ", ".join(told))
    if scores.pair_sites.of:
        yield _row("site right in pairs", share_text(scores.pair_sites))
    if scores.kinds.get("parameter"):
        yield _row("parameter far off", share_text(scores.parameters))
    if scores.set_sizes:
        sizes = ", ".join(f"{count} with {size}" for size, count in scores.set_sizes.items())
        yield _row("candidates per cause", f"{sizes} (alone: 1)")


def _restraint(scores: "Scores") -> Iterator[str]:
    if scores.kinds.get("control"):
        yield _row("false alarms in controls", _of_diagnosed(scores.false_alarms), "at most 3 %")
    outside = scores.kinds.get("outside", 0)
    if outside:
        yield "not in the library: recognised, by the true gap"
        for strength in STRENGTHS:
            yield _row(f"  {strength}", share_text(scores.recognised[strength]))
        yield _row("  0.5 and above", share_text(scores.recognised_from_half), "95 %")
    if outside < scores.cases:
        label = "  claimed wrongly" if outside else "wrongly not in library"
        yield _row(label, _of_diagnosed(scores.wrongly_unknown), "at most 5 %")
        yield _row("more effects than hidden", _of_diagnosed(scores.extra))


def _of_diagnosed(share: Share) -> str:
    return share_text(share) if share.of else "none was diagnosed"


def _numbers(scores: "Scores", mixed: bool) -> Iterator[str]:
    told = sum(one.right.of for one in scores.calibration.bins)
    error = scores.calibration.error
    if error is None:
        yield _row("causes announced", "none")
    elif mixed:
        chance = scores.calibration.error_by_chance
        yield _row("error of confidence", f"{error:.3f} ({told} causes; by chance {chance:.3f})", "0.05")
    shrinkage = scores.shrinkage
    if shrinkage.median_difference is not None:
        points = f"{100 * shrinkage.median_difference:.1f} points ({_cases(len(shrinkage.differences))})"
        yield _row("shrinkage off by (median)", points, "5 points")
        yield _row("  within its 90 % interval", share_text(shrinkage.covered), "85 to 95 %")
    left_out = (
        (shrinkage.too_small, "with too small a gap"),
        (shrinkage.failed, "not computed"),
        (shrinkage.unpredicted, "not predicted"),
    )
    if any(count for count, _ in left_out):
        words = ", ".join(f"{count} {why}" for count, why in left_out if count)
        yield _row("shrinkage left out", words)
    if scores.seconds:
        took = scores.seconds
        text = f"median {took['median']:.0f} s, longest {took['longest']:.0f} s"
        yield _row("one diagnosis", text)
    yield _row("not diagnosed (errors)", ", ".join(scores.errors) or "none")


def _cases(count: int) -> str:
    return "1 case" if count == 1 else f"{count} cases"


def _row(label: str, value: str, reach: str = "") -> str:
    told = f"{label:<{_LABEL}}  {value}"
    return f"{told:<66}to reach: {reach}" if reach else told
