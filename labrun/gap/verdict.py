"""The verdict: no gap, explained by parameters, by causes, in part, or not by anything in the library; in words."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from labrun.gap import criteria
from labrun.gap.diagnosis import Cause, Name, Shrinkage, Sizes, Verdict

_PLAIN = (1e-4, 1e7)


def significant(value: float, digits: int = 2) -> str:
    """Return a number with so many significant digits, without an exponent where it is of usual size: 8000, 0.012."""
    text = f"{value:.{digits}g}"
    if not math.isfinite(value) or not _PLAIN[0] <= abs(value) < _PLAIN[1]:
        return text
    return f"{float(text):.0f}" if "e" in text else text


@dataclass(frozen=True, slots=True)
class Findings:
    """What the verdict is made from.

    Attributes
    ----------
    significant
        Whether the recalibrated gap is beyond what noise leaves; `remains` the same of what the causes leave.
    told_by_repeats
        Whether noise was told from gap by repeats.
    effects, parameters
        Number of causes of each kind.
    """

    sizes: Sizes
    significant: bool
    remains: bool
    told_by_repeats: bool
    effects: int
    parameters: int
    shrinkage: Shrinkage | None

    @property
    def unproven(self) -> bool:
        """Whether causes were found whose help on withheld conditions cannot be told from none at all."""
        share = self.shrinkage
        return (
            self.effects > 0
            and share is not None
            and share.low <= 0.0
            and share.value < criteria.PROVEN_SHARE
        )


def verdict(found: Findings) -> Verdict:
    """Return the verdict."""
    if found.unproven or found.effects + found.parameters == 0 or found.shrinkage is None:
        plain = found.sizes.recalibrated >= max(criteria.FAR_ABOVE_FLOOR * found.sizes.floor, 1.0)
        least_gap = max(criteria.BEYOND_FLOOR * found.sizes.floor, criteria.SMALL_GAP_UNEXPLAINED)
        if found.significant and (plain or (found.told_by_repeats and found.sizes.recalibrated >= least_gap)):
            return "not-in-library"
        return "parameter" if _recalibration_helps(found.sizes) else "no-gap"
    least = next(
        (share for size, share in criteria.DOUBTFUL_SHARES if found.sizes.after >= size),
        criteria.IMPOSTOR_SHARE,
    )
    impostor = found.shrinkage.value < least and found.shrinkage.high < least + criteria.IMPOSTOR_ROOM
    # a parameter's form is the model's own: what it plainly leaves has another cause
    plain = found.remains and found.sizes.after >= max(criteria.FAR_ABOVE_FLOOR * found.sizes.floor, 1.0)
    if impostor and found.remains and (found.effects or plain):
        return "not-in-library"
    if found.effects == 0:
        return "partly-explained" if plain else "parameter"
    whole = criteria.NEARLY_ALL if found.sizes.after >= criteria.LARGE_REMAINDER else criteria.WHOLE_SHARE
    return "explained" if found.shrinkage.value >= whole or not found.remains else "partly-explained"


def _recalibration_helps(sizes: Sizes) -> bool:
    return sizes.raw > criteria.RECALIBRATION_HELPS * max(sizes.recalibrated, sizes.floor)


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
