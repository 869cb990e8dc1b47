"""The verdict: no gap, explained by parameters, by causes, in part, or not by anything in the library; in words."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

from labrun.estimate import significant
from labrun.gap import criteria
from labrun.gap.diagnosis import BeyondScatter, Cause, Name, Shrinkage, Sizes, Verdict


@dataclass(frozen=True, slots=True)
class VerdictBasis:
    """What the verdict is made from.

    Attributes
    ----------
    remains
        Whether what is left, by the causes or without any, is beyond what noise leaves.
    noise_known
        Whether noise is told from gap: by repeats, or by reading errors that are stated.
    effects, parameters
        Number of causes of each kind.
    beyond_scatter
        What is left, less what a scatter of parameters from trial to trial makes.
    trials
        How many there are.
    share_of_seen
        Share of the excess that the causes remove where nothing is withheld.
    better_alone
        A law that without causes explains plainly more than they do, or than the best candidate does where there are
        none, in words; "" if there is none.
    """

    sizes: Sizes
    remains: bool
    noise_known: bool
    effects: int = 0
    parameters: int = 0
    shrinkage: Shrinkage | None = None
    beyond_scatter: BeyondScatter = field(default_factory=BeyondScatter)
    trials: int = 1
    share_of_seen: float = 1.0
    better_alone: str = ""

    @property
    def left_is_gap(self) -> bool:
        """Whether what is left is plainly no noise.

        Its kind says so: its spectrum has lines, a law explains it that no library has, or motion and inputs predict
        it, where it is no smaller than the noise of a sample or, with repeats, well above what these leave. Or its
        size: where repeats tell the noise, far above what that leaves; without them, more than any sensor adds.
        """
        least = criteria.BEYOND_FLOOR * self.sizes.floor if self.noise_known else 1.0
        learned = self.beyond_scatter.learnable >= criteria.LEARNABLE and self.sizes.after >= least
        return (self._is_seen and learned) or bool(self.why_no_noise)

    @property
    def why_no_noise(self) -> str:
        """Why even what motion and inputs do not predict is plainly no noise, in words; "" where it may be noise."""
        if self.better_alone and not self.effects + self.parameters:  # however near the floor it is
            return "a law explains it" if self.sizes.after >= criteria.SMALL_GAP_UNEXPLAINED else ""
        if not self._is_seen:
            return ""
        if self._has_lines:
            return "its spectrum has lines"
        if not self.noise_known:
            return "no sensor adds so much" if self._of_no_sensor else ""
        # what is no more than noise beyond scatter: new beams, another mounting
        far_above = self.sizes.after >= criteria.FAR_ABOVE_FLOOR * self.sizes.floor
        return "repeats agree on it" if far_above and self.beyond_scatter.size > 1.0 else ""

    @property
    def _is_seen(self) -> bool:
        return self.remains and self.sizes.after >= criteria.SMALL_GAP_UNEXPLAINED

    @property
    def _has_lines(self) -> bool:
        return self.beyond_scatter.chance_of_lines <= criteria.CHANCE_OF_LINES

    @property
    def _of_no_sensor(self) -> bool:
        return self.beyond_scatter.size >= criteria.NO_SENSORS_NOISE and self.trials > 1

    @property
    def known_share(self) -> float:
        """Share that the causes remove of what is known to be no noise; of all the excess where noise is known."""
        share = 0.0 if self.shrinkage is None else self.shrinkage.value
        whole = self.noise_known or self._has_lines or self._of_no_sensor
        left = (1.0 - share) * (1.0 if whole else self.beyond_scatter.learnable)
        return share / (share + left) if share + left > 0 else 0.0

    @property
    def most_removed(self) -> float:
        """Upper end of that share: what cannot be told from noise may be no gap that is left."""
        high = 0.0 if self.shrinkage is None else self.shrinkage.high
        return high if self.noise_known else max(high, self.known_share + criteria.FORM_ERROR)

    @property
    def impostors(self) -> bool:
        """Whether causes stand in for something else that makes a plain gap.

        They do if a law explains more without them, or if they leave a plain gap and remove too little; without
        repeats, if that is sure. With repeats it is asked of what they have seen, too: where conditions are withheld,
        recalibrated parameters extrapolate and leave more, and removing that is no merit.
        """
        if self.better_alone:
            return True
        if not self.left_is_gap:
            return False
        if not self.noise_known:
            return self.most_removed < criteria.WHOLE_SHARE
        return min(self.known_share, self.share_of_seen) < criteria.WHOLE_SHARE


def may_help_nothing(found: VerdictBasis) -> bool:
    """Tell whether the share that causes remove of withheld conditions cannot be told from none."""
    return found.shrinkage is not None and found.shrinkage.low <= 0.0


def stands_all_the_same(found: VerdictBasis, without: VerdictBasis) -> bool:
    """Tell whether causes that help nothing in some choice of conditions stand, by what is left with and without them.

    They leave no gap of what plainly was one (without repeats, where a rest of any size may be noise, they remove more
    than they leave, too); or, where repeats tell the noise, they explain the whole of what is beyond it, in no choice
    of conditions more than there is: a share of what may be nothing has no end.
    """
    if found.left_is_gap or found.shrinkage is None:
        return False
    removed = found.shrinkage.value
    if not found.noise_known and removed < 1.0 - removed:
        return False
    whole = removed >= criteria.WHOLE_SHARE and found.shrinkage.high <= 1.0
    plainly = replace(without, better_alone="").left_is_gap
    return plainly or (found.noise_known and without.remains and not found.remains and whole)


def verdict(found: VerdictBasis) -> Verdict:
    """Return the verdict.

    Causes are impostors if another law explains more without them, or if they leave a plain gap and do not explain
    nearly all of what the model left without them; without repeats, where what they leave may be noise, if no resample
    of the conditions has them do so.
    """
    if found.effects + found.parameters == 0:
        if found.left_is_gap:
            return "not-in-library"
        plainly_left = not found.noise_known and found.sizes.after >= criteria.LARGE_REMAINDER
        if _recalibration_helps(found.sizes) and not plainly_left:
            return "parameter"
        return "no-gap" if found.noise_known or not found.remains else "undecided"
    if found.impostors:
        return "not-in-library"
    if found.effects == 0:
        # a parameter's form is the model's own: what it plainly leaves has another cause
        return "partly-explained" if found.left_is_gap else "parameter"
    large = found.noise_known and found.sizes.after >= criteria.LARGE_REMAINDER
    whole = criteria.NEARLY_ALL if large else criteria.WHOLE_SHARE
    explained = found.known_share >= whole or not found.remains
    return "explained" if explained else "partly-explained"


def _recalibration_helps(sizes: Sizes) -> bool:
    return sizes.raw > criteria.RECALIBRATION_HELPS * max(sizes.recalibrated, sizes.floor)


def sentence(
    verdict: Verdict,
    sizes: Sizes,
    causes: Sequence[Cause],
    shrinkage: Shrinkage | None,
    nearest: Sequence[Name],
    *,
    conditions: int,
    noise_known: bool = True,
    differs: Sequence[str] = (),
    rest: bool = False,
    better_alone: str = "",
) -> str:
    """Return the verdict as one sentence, behind one on what differs by trial.

    Parameters
    ----------
    nearest
        What removes most of the gap, if it is no answer: what was chosen, or the best single candidate.
    conditions
        How many there are: of one, nothing could be withheld from the fit.
    rest
        Whether what the causes leave is plainly more than noise.
    better_alone
        See `VerdictBasis`.
    """
    if differs:
        beside = sentence(
            verdict,
            sizes,
            causes,
            shrinkage,
            nearest,
            conditions=conditions,
            noise_known=noise_known,
            rest=rest,
            better_alone=better_alone,
        )
        return f"{_capital(' and '.join(differs))}. Beside that: {beside[:1].lower()}{beside[1:]}"
    raw, recalibrated = significant(sizes.raw), significant(sizes.recalibrated)
    unit = "one trial's noise" if noise_known else "the noise of a sample"
    removed = "" if shrinkage is None else f" {100 * shrinkage.value:.0f} %"
    if causes:
        said = _of_causes(
            verdict, sizes, causes, removed, unit, conditions=conditions, sure=noise_known or rest
        )
        more = rest and verdict == "explained"
        but = "more than noise" if sizes.after >= 1.0 else "small, but not all of it noise"
        return f"{said[:-1]}; that rest is {but}: {_OTHER_FORM}." if more else said
    if verdict == "no-gap":
        return _of_noise(recalibrated, unit, sizes)
    small = sizes.recalibrated < 1.0  # in units of what a sensor adds
    if verdict == "undecided":
        return (
            f"No gap that stands out of noise: what model and measurement differ by ({recalibrated} times {unit}) may "
            "be noise alone; repeats would tell."
            if small
            else f"Nothing that was tried explains what is left ({recalibrated} times {unit}): it is a gap, or "
            "disturbances that repeats would show."
        )
    if verdict == "parameter":
        unexplained = "the rest may be noise" if small else "nothing that was tried explains the rest"
        end = "nothing is missing" if noise_known else unexplained
        return (
            f"Parameters explain it: recalibrated within what is known of them, the gap falls from {raw} to "
            f"{recalibrated} times {unit}, and {end}."
        )
    names, several = " and ".join(one.words for one in nearest), len(nearest) > 1
    does, it = ("remove", "them") if several else ("removes", "it")
    told = f"; the nearest, {names}, {does}{removed or ' too little'} of it" if nearest else ""
    if better_alone:  # than causes do, or than anything that was tried
        told += (
            f", but {better_alone} explains more without {it}" if removed else f"; {better_alone} explains it"
        )
    outside = "" if noise_known else ", or acts from outside of what was recorded"
    return (
        f"The cause is not in the library{outside}: a gap of {recalibrated} times {unit} remains after "
        f"recalibration{told}."
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
        sure, were = criteria.SURE_WITHOUT_REPEATS, "without repeats were right on simulated benches"
        if conditions == 1:
            sure, were = (
                criteria.SURE_OF_ONE_TRIAL,
                "by one trial of a real machine were so by all of its trials",
            )
        found.append(
            "No condition was repeated: how much of what is left is noise is not known. A cause was believed where it "
            "explains more of the residual than anything does of the residual with its phases at random, and with a "
            f"confidence of at most {100 * sure:.0f} %: about so many of those announced {were}."
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
            "labrun gap test MODEL --fresh RUN tells how far the corrected model (--save-model FILE) predicts new data."
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
