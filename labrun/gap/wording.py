"""The diagnosis in sentences."""

from collections.abc import Sequence

from labrun.gap.diagnosis import Cause, Name, Shrinkage, Sizes, Verdict
from labrun.gap.numbers import significant


def sentence(
    verdict: Verdict,
    sizes: Sizes,
    causes: Sequence[Cause],
    shrinkage: Shrinkage | None,
    best: Name | None,
    *,
    conditions: int,
) -> str:
    """Return the verdict as one sentence.

    Parameters
    ----------
    best
        The candidate that removes most of the gap.
    conditions
        How many there are: of one, nothing could be withheld from the fit.
    """
    one_only = "on the data of the fit, as there is one condition only"
    where = "on conditions the fit did not see" if conditions > 1 else one_only
    raw, recalibrated = significant(sizes.raw), significant(sizes.recalibrated)
    after, floor = significant(sizes.after), significant(sizes.floor)
    named = " and ".join(cause.name.words for cause in causes)
    if verdict == "no-gap":
        return (
            f"No gap beyond noise: what model and measurement differ by ({recalibrated} times one trial's "
            f"noise) is what noise leaves (up to {floor})."
        )
    if verdict == "parameter" and not causes:
        return (
            f"Parameters explain it: recalibrated within what is known of them, the gap falls from {raw} to "
            f"{recalibrated} times one trial's noise, and nothing is missing."
        )
    removed = "" if shrinkage is None else f" {100 * shrinkage.value:.0f} %"
    verb = "explain" if len(causes) > 1 else "explains"
    if verdict == "parameter":
        return f"A stated value is wrong: {named} {verb}{removed} of the gap {where}."
    if verdict == "explained":
        return (
            f"{_capital(named)} {verb}{removed} of the gap {where} "
            f"({recalibrated} to {after} times one trial's noise)."
        )
    if verdict == "partly-explained":
        also = "" if conditions > 1 else f" {one_only}"
        return (
            f"{_capital(named)} {verb}{removed} of the gap{also}; {after} times one trial's noise remains that "
            "nothing in the library accounts for."
        )
    nearest = (
        f"; the nearest, {best.words}, removes{removed or ' too little'} of it" if best is not None else ""
    )
    return (
        f"The cause is not in the library: a gap of {recalibrated} times one trial's noise remains after "
        f"recalibration{nearest}."
    )


def limitations(*, repeats: int, conditions: int, basis: str, single_trial: bool, rejected: int) -> list[str]:
    """Return what the data do not allow to say."""
    found = []
    if single_trial:
        found.append(
            "One trial only: nothing was repeated and nothing could be withheld; take this as a hint."
        )
    if basis == "residual":
        found.append(
            "No condition was repeated: gap and noise are not separable by repeats. What the best candidates together "
            "leave was taken as noise, so a cause outside the library would be taken for noise, too."
        )
    elif repeats < 3:
        found.append(
            f"Only {repeats} repeat{'s' if repeats > 1 else ''} of some conditions: the noise floor is uncertain; "
            "three or more tell it better."
        )
    if conditions == 1:
        found.append(
            "One condition only: nothing could be withheld from the fit, and figures are those of the fit itself."
        )
    elif conditions < 4:
        found.append(f"{conditions} conditions only: the figures on withheld conditions rest on few.")
    if rejected:
        found.append(f"{rejected} rejected or failed trials were left out.")
    return found


def what_next(verdict: Verdict, causes: Sequence[Cause], *, repeats: int) -> list[str]:
    """Return what to do now."""
    found = []
    doubtful = [cause for cause in causes if cause.indistinguishable_from]
    for cause in doubtful:
        others = " or ".join(name.words for name in cause.indistinguishable_from[:3])
        found.append(
            f"These data cannot tell {cause.name.words} from {others}: labrun gap next writes the experiment that can."
        )
    if verdict in ("explained", "partly-explained", "parameter") and causes and not doubtful:
        found.append(
            "labrun gap diagnose --save-model FILE writes the corrected model; run it against new data."
        )
    if verdict == "not-in-library":
        found.append(
            "Look at where it is and at the missing force: an effect of that form, as a plugin, can be tried next."
        )
    if verdict == "partly-explained":
        found.append("Diagnose again with the corrected model to see where the rest is.")
    if verdict == "no-gap" and repeats < 3:
        found.append("Repeat every condition three times or more: a smaller gap becomes visible.")
    if verdict == "parameter" and not causes:
        found.append("Take the recalibrated parameters over into the model.")
    return found


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
