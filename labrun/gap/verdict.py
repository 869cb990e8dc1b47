"""The verdict: no gap, explained by parameters, by causes, in part, or not by anything in the library; in words."""

from collections.abc import Sequence
from dataclasses import dataclass, field

from labrun.estimate import significant
from labrun.gap import criteria
from labrun.gap.diagnosis import BeyondScatter, Cause, Name, Shrinkage, Sizes, Verdict


@dataclass(frozen=True, slots=True)
class VerdictBasis:
    """What the verdict is made from.

    Attributes
    ----------
    significant
        Whether the recalibrated gap is beyond what noise leaves; `remains` the same of what the causes leave.
    noise_known
        Whether noise is told from gap: by repeats, or by reading errors that are stated.
    effects, parameters
        Number of causes of each kind.
    beyond_scatter
        What is left, less what a scatter of parameters from trial to trial makes.
    trials
        How many there are.
    """

    sizes: Sizes
    significant: bool
    remains: bool
    noise_known: bool
    effects: int
    parameters: int
    shrinkage: Shrinkage | None
    beyond_scatter: BeyondScatter = field(default_factory=BeyondScatter)
    trials: int = 1

    @property
    def known_share(self) -> float:
        """Share that the causes remove of what is known to be no noise; of all the excess where noise is known."""
        share = 0.0 if self.shrinkage is None else self.shrinkage.value
        if self.noise_known:
            return share
        left = (1.0 - share) * self.beyond_scatter.learnable
        return share / (share + left) if share + left > 0 else 0.0

    @property
    def rest(self) -> bool:
        """Whether causes that explain the gap leave a rest of it that is plainly more than noise."""
        if not self.noise_known:
            return self.beyond_scatter.learnable >= criteria.LEARNABLE and self.sizes.after >= 1.0
        least = max(criteria.BEYOND_FLOOR * self.sizes.floor, criteria.SMALL_GAP_UNEXPLAINED)
        return self.remains and self.sizes.after >= least

    @property
    def unproven(self) -> bool:
        """Whether causes were found whose help on withheld conditions cannot be told from none at all."""
        share = self.shrinkage
        if self.effects + self.parameters == 0 or share is None or share.low > 0.0:
            return False
        proven = share.value >= criteria.PROVEN_SHARE and share.high < criteria.OF_NOTHING
        return not (self.noise_known and proven)


def verdict(found: VerdictBasis) -> Verdict:
    """Return the verdict."""
    if found.unproven or found.effects + found.parameters == 0 or found.shrinkage is None:
        if found.significant and _unexplained(found):
            return "not-in-library"
        plainly_left = not found.noise_known and found.sizes.recalibrated >= criteria.LARGE_REMAINDER
        if _recalibration_helps(found.sizes) and not plainly_left:
            return "parameter"
        return "no-gap" if found.noise_known or not found.significant else "undecided"
    plain = found.sizes.after >= max(criteria.FAR_ABOVE_FLOOR * found.sizes.floor, 1.0)
    if not found.noise_known:
        plain, least, whole = (
            found.beyond_scatter.learnable >= criteria.LEARNABLE,
            criteria.IMPOSTOR_SHARE,
            criteria.WHOLE_SHARE,
        )
        impostor = found.known_share < least
    else:
        least = next(
            (share for size, share in criteria.DOUBTFUL_SHARES if found.sizes.after >= size),
            criteria.IMPOSTOR_SHARE,
        )
        impostor = found.shrinkage.value < least and found.shrinkage.high < least + criteria.IMPOSTOR_ROOM
        whole = criteria.NEARLY_ALL if found.sizes.after >= criteria.LARGE_REMAINDER else criteria.WHOLE_SHARE
    # a parameter's form is the model's own: what it plainly leaves has another cause
    plain = found.remains and plain
    if impostor and found.remains and (found.effects or plain):
        return "not-in-library"
    if found.effects == 0:
        return "partly-explained" if plain else "parameter"
    return "explained" if found.known_share >= whole or not found.remains else "partly-explained"


def _unexplained(found: VerdictBasis) -> bool:
    """Tell whether there is a gap without a cause: plainly more than noise, or at least no noise by its kind."""
    left = found.beyond_scatter
    learnable = left.learnable >= criteria.LEARNABLE
    if not found.noise_known:
        lines = left.chance_of_lines <= criteria.CHANCE_OF_LINES and left.size >= 1.0
        large = left.size >= criteria.NO_SENSORS_NOISE and found.trials > 1
        return (learnable or lines or large) and found.sizes.recalibrated >= 1.0
    if left.size <= 1.0 and not learnable:
        return False  # scatter of parameters from condition to condition: new beams, another mounting
    floor = found.sizes.floor
    if found.sizes.recalibrated >= max(criteria.FAR_ABOVE_FLOOR * floor, criteria.SMALL_GAP_UNEXPLAINED):
        return True
    # slow noise has few independent numbers a trial: the mean of a few repeats is then above the floor by chance
    small = max(criteria.BEYOND_FLOOR * floor, criteria.SMALL_GAP_UNEXPLAINED)
    return found.sizes.recalibrated >= small and learnable


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
    noise_known: bool = True,
    differs: Sequence[str] = (),
    rest: bool = False,
) -> str:
    """Return the verdict as one sentence, behind one on what differs by trial.

    Parameters
    ----------
    best
        The candidate that removes most of the gap.
    conditions
        How many there are: of one, nothing could be withheld from the fit.
    rest
        Whether what the causes leave is plainly more than noise.
    """
    if differs:
        beside = sentence(
            verdict,
            sizes,
            causes,
            shrinkage,
            best,
            conditions=conditions,
            noise_known=noise_known,
            rest=rest,
        )
        return f"{_capital(' and '.join(differs))}. Beside that: {beside[:1].lower()}{beside[1:]}"
    raw, recalibrated = significant(sizes.raw), significant(sizes.recalibrated)
    unit = "one trial's noise" if noise_known else "the noise of a sample"
    removed = "" if shrinkage is None else f" {100 * shrinkage.value:.0f} %"
    if causes:
        said = _of_causes(verdict, sizes, causes, removed, unit, conditions=conditions, sure=noise_known)
        return f"{said[:-1]}; that rest is more than noise: {_OTHER_FORM}." if rest else said
    if verdict == "no-gap":
        return _of_noise(recalibrated, unit, sizes)
    if verdict == "undecided":
        return (
            f"Nothing that was tried explains what is left ({recalibrated} times {unit}): it is a gap, or disturbances "
            "that repeats would show."
        )
    if verdict == "parameter":
        end = "nothing is missing" if noise_known else "nothing that was tried explains the rest"
        return (
            f"Parameters explain it: recalibrated within what is known of them, the gap falls from {raw} to "
            f"{recalibrated} times {unit}, and {end}."
        )
    nearest = "" if best is None else f"; the nearest, {best.words}, removes{removed or ' too little'} of it"
    outside = "" if noise_known else ", or acts from outside of what was recorded"
    return (
        f"The cause is not in the library{outside}: a gap of {recalibrated} times {unit} remains after "
        f"recalibration{nearest}."
    )


def _of_noise(recalibrated: str, unit: str, sizes: Sizes) -> str:
    floor = significant(sizes.floor)
    if sizes.recalibrated > sizes.floor:
        return (
            f"No gap that can be told from noise: model and measurement differ by {recalibrated} times {unit}, more "
            f"than repeats let expect ({floor}), but no more than parameters that scatter from trial to trial, or "
            "noise that is slow beside a trial, make."
        )
    return (
        f"No gap beyond noise: what model and measurement differ by ({recalibrated} times {unit}) is what noise "
        f"leaves (up to {floor})."
    )


_OTHER_FORM = "nature's form may be another one, or there is more"


def _of_causes(
    verdict: Verdict,
    sizes: Sizes,
    causes: Sequence[Cause],
    removed: str,
    unit: str,
    *,
    conditions: int,
    sure: bool,
) -> str:
    one_only = "on blocks of time the fit did not see, as there is one condition only"
    where = "on conditions the fit did not see" if conditions > 1 else one_only
    named = " and ".join(cause.name.words for cause in causes)
    does = f"{named} {'explain' if len(causes) > 1 else 'explains'}{removed} of the gap"
    recalibrated, after = significant(sizes.recalibrated), significant(sizes.after)
    if verdict == "parameter":
        return f"A stated value is wrong: {does} {where}."
    if verdict == "explained":
        return f"{_capital(does)} {where} ({recalibrated} to {after} times {unit})."
    also = "" if conditions > 1 else f" {one_only}"
    rest = "nothing in the library accounts for" + ("" if sure else ", or that is no gap")
    return f"{_capital(does)}{also}; {after} times {unit} remains that {rest}."


def limitations(
    *, repeats: int, enough: bool, conditions: int, basis: str, single_trial: bool, rejected: int
) -> list[str]:
    """Return what the data do not allow to say.

    Parameters
    ----------
    repeats
        Of the condition that was measured least often.
    enough
        Whether all repeats together tell the noise.
    """
    found = []
    if single_trial:
        found.append(
            "One trial only: nothing was repeated, and only blocks of its time could be withheld; take this as a hint."
        )
    if basis == "residual":
        found.append(
            "No condition was repeated: how much of what is left is noise is not known. A cause was believed where it "
            "explains more of the residual than anything does of the residual with its phases at random, and with a "
            f"confidence of at most {100 * criteria.SURE_WITHOUT_REPEATS:.0f} %: so many of those announced without "
            "repeats were right on simulated benches."
        )
    elif basis == "stated":
        found.append(
            "No condition was repeated: noise is the reading error that the recording states. A gap that is smaller "
            "than that is not seen, and one that was stated too small makes noise a gap."
        )
    elif repeats < 3 and not enough:
        found.append(
            f"Only {repeats} repeat{'s' if repeats > 1 else ''} of some conditions: the noise floor is uncertain; "
            "three or more tell it better."
        )
    if conditions == 1:
        found.append(
            "One condition only: blocks of time were withheld from the fit; nothing tells what another condition shows."
        )
    elif conditions < 4:
        found.append(f"{conditions} conditions only: the figures on withheld conditions rest on few.")
    if rejected:
        found.append(f"{rejected} rejected or failed trials were left out.")
    return found


def what_next(
    verdict: Verdict, causes: Sequence[Cause], doubts: Sequence[Sequence[Name]], *, repeats: int
) -> list[str]:
    """Return what to do now.

    Parameters
    ----------
    doubts
        Per cause, all that the data cannot tell from it, the likeliest first.
    """
    found = []
    doubtful = [(cause, others) for cause, others in zip(causes, doubts, strict=True) if others]
    for cause, alike in doubtful:
        others = " or ".join(name.words for name in alike[:3])
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
    if verdict in ("no-gap", "undecided") and repeats < 3:
        found.append("Repeat every condition three times or more: a smaller gap becomes visible.")
    if verdict == "parameter" and not causes:
        found.append("Take the recalibrated parameters over into the model.")
    return found


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
