"""The answer read off the errors on unseen data: the ladder, what is left, the verdict, and all of it as a sentence."""

from collections.abc import Sequence

import numpy as np

from labrun.arrays import FloatArray
from labrun.estimate import significant
from labrun.gap import criteria, numerics
from labrun.gap.diagnosis import Cause, Name, Rest, Rung, Shrinkage, Sizes, Verdict
from labrun.gap.evidence import UnseenError
from labrun.gap.held_out import group_means
from labrun.gap.learnable import dependence, learnable_share
from labrun.gap.noise import Noise
from labrun.gap.pipeline import Search
from labrun.gap.selection import CauseSet

_NEW_CONDITIONS = 3
"""Conditions of the experiment that the interval of the share is for, where repeats show the noise."""
_FORM_ERROR, _EXTRAPOLATED = 0.006, 0.6
"""Widening of that interval: by the idealised form of effects, and below by this part of what is left."""


def ladder_of(search: Search, outputs: Sequence[str]) -> tuple[Rung, ...]:
    """Return the error on unseen data as stated, recalibrated, and with each cause in turn."""
    selection = search.selection

    def rung(step: str, cause: Name | None, error: UnseenError, closes: float) -> Rung:
        errors = dict(zip(outputs, map(float, error.rms), strict=True))
        return Rung(step, cause, errors, error.in_noise, closes)

    rungs = [
        rung("as stated", None, search.stated, 0.0),
        rung("recalibrated", None, selection.reference.error, 0.0),
    ]
    for cause, model in zip(selection.chosen, selection.steps[1:], strict=True):
        rungs.append(rung(f"+ {cause.name.words}", cause.name, model.error, cause.closes))
    return tuple(rungs)


def sizes_of(search: Search) -> Sizes:
    """Return the gap as stated, recalibrated and with the causes, in units of one trial's noise.

    Without causes the recalibrated gap is that of the data the fit has seen: extrapolated parameters add to the other.
    """
    selection = search.selection
    stated, recalibrated = search.stated.in_noise, selection.reference.error.in_noise
    if not selection.chosen:
        return Sizes(stated, search.recalibrated.gap, search.recalibrated.gap, search.floor)
    return Sizes(stated, recalibrated, selection.error.in_noise, search.floor)


def shrinkage_of(search: Search, rng: np.random.Generator) -> Shrinkage | None:
    """Return the share of the squared gap that the causes remove of unseen data, with a 90 % interval.

    The interval is that of an experiment of a few new conditions: conditions are resampled whole, each with the noise
    of its mean drawn again. It is wider below, since new conditions extrapolate forms and parameters.
    """
    selection = search.selection
    if not selection.chosen:
        return None
    data, noise = search.data, search.noise
    before, after = selection.reference.error.excess, selection.error.excess
    then, now = (group_means(data, error.residual) for error in (before, after))
    groups = len(then)
    sizes = np.array([len(mean) for mean, _ in then], dtype=float)
    fresh = min(groups, _NEW_CONDITIONS) if noise.known else groups
    shares = []
    for _ in range(numerics.RESAMPLES):
        drawn = group_means(data, noise.draw(data, rng))
        pairs = [
            [_redrawn(side[group], drawn[group][0], noise, group) for side in (then, now)]
            for group in range(groups)
        ]
        first, second = np.array(pairs).T
        chosen = rng.integers(0, groups, fresh)
        total = float(sizes[chosen] @ first[chosen])
        if total > 0.0:
            shares.append(1.0 - float(sizes[chosen] @ second[chosen]) / total)
    value = min(1.0 - after.total / before.total if before.total > 0.0 else 0.0, 1.0)
    low, high = np.percentile(shares, [5.0, 95.0]) if shares else (value, value)
    low = min(low, value) - _FORM_ERROR - _EXTRAPOLATED * (1.0 - value)
    high = max(high, value) + _FORM_ERROR
    if not noise.known:  # what cannot be told from noise may be no gap that is left
        high = max(high, 1.0)
    return Shrinkage(float(value), float(low), float(high))


def _redrawn(mean: tuple[FloatArray, int], drawn: FloatArray, noise: Noise, group: int) -> float:
    """Return the excess had the noise come out differently; its own square is taken off as twice the floor."""
    residual, count = mean
    length = min(len(residual), len(drawn))
    squares = np.mean(np.square((residual[:length] + drawn[:length]) / noise.sd), axis=0)
    return float(np.mean(squares - 2.0 * noise.mean_floor(group, count)))


def rest_of(search: Search, model: CauseSet, *, ask: bool) -> Rest:
    """Describe what a model leaves.

    Parameters
    ----------
    ask
        Whether to ask what of it is predictable; that takes a regression.
    """
    gap, rest = search.selection.reference.error.in_noise, model.error.in_noise
    if model is search.selection.reference:
        rest = search.recalibrated.gap
    within = search.noise.known and rest <= search.floor
    share = rest / gap if gap > 0.0 and model is not search.selection.reference else 1.0
    followed = any(output.followed for output in search.model.outputs)
    nested = search.selection.nested if search.selection.chosen else None
    if within or followed or not ask:
        return Rest(rest, share, within_noise=within, nested=nested)
    problem, z = model.base.problem, model.base.z
    predictable = learnable_share(problem, z)
    signals = dependence(problem, z, predictable) if predictable >= criteria.NEGLIGIBLE else ()
    return Rest(rest, share, predictable, signals, nested=nested)


def verdict_of(search: Search, causes: Sequence[Cause], rest: Rest) -> Verdict:
    """Read the verdict off the ladder."""
    if causes:
        if rest.within_noise or rest.share_of_gap < criteria.NEGLIGIBLE:
            return "explained"
        return "mostly-explained" if rest.share_of_gap < criteria.MOST else "partly-explained"
    if rest.within_noise:
        return "no-gap"
    if search.noise.known or (rest.predictable or 0.0) >= criteria.NEGLIGIBLE:
        return "unexplained"
    return "cannot-tell"


def sentence_of(
    verdict: Verdict,
    sizes: Sizes,
    causes: Sequence[Cause],
    rest: Rest,
    differs: Sequence[str],
    noise: Noise,
    *,
    complete: bool,
) -> str:
    """Return the answer as one sentence, behind one on what differs by trial."""
    unit = "the noise of one trial" if noise.known else "the sensor's noise"
    recalibrated = significant(sizes.recalibrated)
    if causes:
        shares = [f"{cause.name.words} {_closes(cause)}" for cause in causes]
        text = f"{' and '.join(shares)}; {_rest_words(rest, unit)}"
    elif verdict == "no-gap":
        helps = sizes.raw > sizes.floor and sizes.raw > sizes.recalibrated
        text = (
            f"no gap beyond noise: after recalibration model and measurement differ by {recalibrated} times {unit}, "
            f"and noise alone leaves up to {significant(sizes.floor)}"
            + (f"; as stated, the model was {significant(sizes.raw)} times {unit} off" if helps else "")
        )
    else:
        nothing = (
            "no cause in the library improves the prediction of data that the fit has not seen"
            if complete
            else "the search was stopped before it found a cause"
        )
        text = f"{nothing}; {_rest_words(rest, unit)}"
    text = f"{text[:1].upper()}{text[1:]}."
    if not differs:
        return text
    first = " and ".join(differs)
    return f"{first[:1].upper()}{first[1:]}. Beside that: {text[:1].lower()}{text[1:]}"


def _closes(cause: Cause) -> str:
    if cause.closes < criteria.SHARE_OF_GAP <= cause.returns:
        return "helps together with the next cause only"
    return f"closes {100 * cause.closes:.0f} % of the gap"


def _rest_words(rest: Rest, unit: str) -> str:
    size = f"{significant(rest.in_noise)} times {unit}"
    if rest.within_noise:
        return f"the rest ({size}) is within the noise"
    share = (
        f"{100 * rest.share_of_gap:.0f} % of the gap ({size}) is left"
        if rest.share_of_gap < 1.0
        else f"{size} is left"
    )
    if rest.predictable is None:
        return share
    depends = f" from {' and '.join(rest.depends_on)}" if rest.depends_on else " from motion and inputs"
    return f"{share}, of which {100 * rest.predictable:.0f} % is predictable{depends}"


def limitations_of(search: Search) -> list[str]:
    """Return what the data do not allow to say."""
    data, noise = search.data, search.noise
    conditions, sentences = len(data.conditions), []
    if len(search.dataset.trials) == 1:
        sentences.append(
            "One trial only: nothing was repeated, and only blocks of its time could be withheld."
        )
    if noise.basis == "residual":
        sentences.append(
            "No condition was repeated: how much of what is left is noise is not known. A cause is named where it "
            "improves the prediction of data that the fit has not seen."
        )
    elif noise.basis == "stated":
        sentences.append(
            "No condition was repeated: the noise is the reading error that the recording states. A gap smaller than "
            "that is not seen, and an error stated too small makes noise a gap."
        )
    elif data.repeats < 3 and noise.freedom < criteria.ENOUGH_FREEDOM:
        several = "s" if data.repeats > 1 else ""
        sentences.append(
            f"Only {data.repeats} repeat{several} of some conditions: the noise floor is uncertain; three or more "
            "determine it better."
        )
    if conditions == 1:
        sentences.append(
            "One condition only: blocks of time were withheld; the data do not show what another condition would."
        )
    elif conditions < 4:
        sentences.append(f"{conditions} conditions only: the errors on unseen conditions rest on few.")
    if search.dataset.left_out:
        sentences.append(f"{search.dataset.left_out} rejected or failed trials were left out.")
    return sentences


def next_steps(
    verdict: Verdict, causes: Sequence[Cause], rest: Rest, repeats: int, stopped: str = ""
) -> list[str]:
    """Return what to do now, in sentences.

    Parameters
    ----------
    stopped
        Why the search ended early, "interrupted" or "time"; "" where it ended by itself.
    """
    if stopped:
        longer = "with a longer --within" if stopped == "time" else "again"
        return [f"The search was not finished: run the same command {longer} for the whole answer."]
    steps = []
    doubtful = [cause for cause in causes if cause.rivals]
    for cause in doubtful:
        rivals = " or ".join(name.words for name in cause.rivals[:3])
        steps.append(
            f"These data do not separate {cause.name.words} from {rivals}: labrun gap next proposes the experiment "
            "that does."
        )
    if causes and not doubtful:
        steps.append(
            "labrun gap test MODEL --fresh RUN measures how well the corrected model (--save-model FILE) predicts new "
            "data."
        )
    if verdict in ("partly-explained", "unexplained") and rest.predictable:
        steps.append(
            "labrun gap diagnose --explain-rest proposes a law for the rest; an effect of that form can be added as a "
            "plugin."
        )
    if verdict in ("no-gap", "cannot-tell") and repeats < 3:
        steps.append("Repeat every condition three times or more: a smaller gap becomes visible.")
    return steps
