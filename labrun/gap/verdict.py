"""The verdict: no gap, explained by parameters, by causes, in part, or not by anything in the library."""

from dataclasses import dataclass

from labrun.gap import criteria
from labrun.gap.diagnosis import Shrinkage, Sizes, Verdict


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
