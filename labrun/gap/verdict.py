"""The verdict: no gap, explained by parameters, by causes, in part, or not by anything in the library."""

from dataclasses import dataclass

from labrun.gap.diagnosis import Shrinkage, Sizes, Verdict

_UNKNOWN = 0.6
"""Share of the excess below which the best of the library is an impostor: true effects remove 97 % in the median,
effects that stand in for one that is not there at most 60 %."""
_DOUBTFUL = ((1.0, 0.88), (0.5, 0.8))
"""The same where a plain remainder is left (in units of one trial's noise): more than what is in the library leaves."""
_LARGE, _NEARLY_ALL = 3.0, 0.995
"""A remainder of several times one trial's noise is part of the answer, unless it is next to nothing of the gap."""
_WHOLE = 0.85
_SMALL = 0.3
"""A gap below this part of one trial's noise that nothing in the library explains is left alone."""
_FAR_ABOVE = 3.0
"""How far above the floor a gap is told from noise even where nothing was repeated."""
_BEYOND_FLOOR = 1.5
"""How far above the floor a gap is that nothing explains: noise alone is above it in 5 of 100 experiments."""
_PROVEN = 0.9
"""Share of the excess beyond which a cause stands, even if few of the conditions show it at all."""
_ROOM = 0.1
"""By how much the interval of the share may reach beyond that limit."""


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
        return self.effects > 0 and share is not None and share.low <= 0.0 and share.value < _PROVEN


def verdict(found: Findings) -> Verdict:
    """Return the verdict."""
    if found.unproven or found.effects + found.parameters == 0 or found.shrinkage is None:
        plain = found.sizes.recalibrated >= max(_FAR_ABOVE * found.sizes.floor, 1.0)
        least_gap = max(_BEYOND_FLOOR * found.sizes.floor, _SMALL)
        if found.significant and (plain or (found.told_by_repeats and found.sizes.recalibrated >= least_gap)):
            return "not-in-library"
        return "parameter" if _recalibration_helps(found.sizes) else "no-gap"
    least = next((share for size, share in _DOUBTFUL if found.sizes.after >= size), _UNKNOWN)
    impostor = found.shrinkage.value < least and found.shrinkage.high < least + _ROOM
    # a parameter's form is the model's own: what it plainly leaves has another cause
    plain = found.remains and found.sizes.after >= max(_FAR_ABOVE * found.sizes.floor, 1.0)
    if impostor and found.remains and (found.effects or plain):
        return "not-in-library"
    if found.effects == 0:
        return "partly-explained" if plain else "parameter"
    whole = _NEARLY_ALL if found.sizes.after >= _LARGE else _WHOLE
    return "explained" if found.shrinkage.value >= whole or not found.remains else "partly-explained"


def _recalibration_helps(sizes: Sizes) -> bool:
    return sizes.raw > max(1.5 * sizes.recalibrated, 1.5 * sizes.floor)
