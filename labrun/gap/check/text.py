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


def screen(checked: "Checked") -> str:
    """Return everything a person has to know before looking into the table of cases."""
    scores = checked.scores
    lines = [
        f"{scores.cases} cases; {checked.use}",
        f"seal {checked.seal[:16]}... was printed first; every answer is the one that was sealed",
        "",
        *_naming(scores),
        "",
        *_restraint(scores),
        "",
        *_numbers(scores),
    ]
    if len(checked.programmes) > 1:
        lines.append(f"different code diagnosed these cases: {', '.join(checked.programmes)}")
    wrong = sum(not one.good for one in checked.judged)
    lines += ["", f"every case, and the {wrong} that went wrong: {checked.folder / 'check.md'}"]
    return "\n".join(lines)


def share_text(share: Share) -> str:
    """Return a share with its interval: "18 of 20: 90 % [68, 99]"."""
    value, interval = share.value, share.ci95
    if value is None or interval is None:
        return "no such case"
    return (
        f"{share.hits} of {share.of}: {100 * value:.0f} % [{100 * interval[0]:.0f}, {100 * interval[1]:.0f}]"
    )


def _naming(scores: "Scores") -> Iterator[str]:
    yield "cause named, alone or in a set of two, by the true gap in units of one trial's noise"
    for strength in STRENGTHS:
        yield _row(f"  {strength}", share_text(scores.named[strength]), _TO_REACH.get(strength, ""))
    yield _row("site right among them", share_text(scores.sites), "97 %")
    for strength, counts in scores.pairs.items():
        both, one, none = (counts.get(name, 0) for name in ("both-named", "one-named", "none-named"))
        yield _row(f"pairs, {strength}", f"both named {both}, one {one}, none {none}")
    yield _row("parameter far off", share_text(scores.parameters))
    sizes = ", ".join(f"{count} with {size}" for size, count in scores.set_sizes.items())
    yield _row("candidates per cause", f"{sizes} (alone: 1)" if sizes else "none announced")


def _restraint(scores: "Scores") -> Iterator[str]:
    yield _row("false alarms in controls", share_text(scores.false_alarms), "at most 3 %")
    yield "not in the library: recognised, by the true gap"
    for strength in STRENGTHS:
        yield _row(
            f"  {strength}", share_text(scores.recognised[strength]), "95 %" if strength in _TO_REACH else ""
        )
    yield _row("  claimed wrongly", share_text(scores.wrongly_unknown), "at most 5 %")
    yield _row("more effects than hidden", share_text(scores.extra))


def _numbers(scores: "Scores") -> Iterator[str]:
    error = scores.calibration.error
    told = sum(one.right.of for one in scores.calibration.bins)
    yield _row(
        "error of confidence",
        "no cause announced" if error is None else f"{error:.3f} ({told} causes)",
        "0.05",
    )
    shrinkage = scores.shrinkage
    if shrinkage.median_difference is None:
        yield _row("shrinkage", "no case to compare it on")
    else:
        points = f"{100 * shrinkage.median_difference:.1f} points ({len(shrinkage.differences)} cases)"
        yield _row("shrinkage off by (median)", points, "5 points")
        yield _row("  within its 90 % interval", share_text(shrinkage.covered), "85 to 95 %")
    if shrinkage.too_small or shrinkage.failed:
        yield _row(
            "  left out", f"{shrinkage.too_small} with too small a gap, {shrinkage.failed} not computed"
        )
    if scores.seconds:
        took = scores.seconds
        text = f"median {took['median']:.0f} s, longest {took['longest']:.0f} s"
        yield _row("one diagnosis", text)
    yield _row("not diagnosed (errors)", ", ".join(scores.errors) or "none")


def _row(label: str, value: str, reach: str = "") -> str:
    told = f"{label:<{_LABEL}}  {value}"
    return f"{told:<66}to reach: {reach}" if reach else told
